"""A submap that ruins its worker harms only itself: crash, endless job, held interpreter, memory, a stopped worker."""

from __future__ import annotations

import os
import signal
from contextlib import ExitStack
from datetime import datetime

import pytest

from tests.support.fake_recogniser import EATS_MEMORY, HANGS, HOLDS_EVERY_THREAD, SEGFAULTS
from tests.support.patience import eventually, in_time
from tests.support.processes import is_free, is_running
from tests.support.town import running_town


@pytest.fixture
def start(tmp_path):
    with ExitStack() as towns:
        yield lambda **settings: towns.enter_context(running_town(tmp_path / "home", **settings))


def respawns_s(service):
    """From the end of each worker to the start of the next process, as the log says; at least one."""
    pauses, last = [], None
    for event in service.events:
        if event["event"] == "worker_ended":
            last = datetime.fromisoformat(event["timestamp"])
        elif event["event"] == "worker_started" and last is not None:
            pauses.append((datetime.fromisoformat(event["timestamp"]) - last).total_seconds())
    assert pauses
    return pauses


def failures(town, reasons):
    """Post what ruins its worker; how each ended is looked at when called."""
    posted = {mischief: town.posted(f"poison{mischief}", mischief, mischief) for mischief in reasons}

    def require() -> None:
        for mischief, operation in posted.items():
            failed = town.ended(operation)
            assert (failed["state"], failed["attempts"]) == ("FAILED", 2)
            assert reasons[mischief] in failed["failure"]["message"]

    return require


def ends(town):
    """How workers ended."""
    return {event["end"] for event in town.service.events if event["event"] == "worker_ended"}


def test_poison_submaps_fail_with_their_reasons_and_others_are_described(start):
    town = start(workers=2, max_attempts=2, worker_memory_mb=512)
    reasons = {
        SEGFAULTS: "2 attempts, the last one ended because its worker was ended by signal 11 (Segmentation fault)",
        EATS_MEMORY: "the job needs more memory than a worker may take",
    }
    require_failures = failures(town, reasons)
    good = [town.posted(f"good{number}", number) for number in range(5)]
    assert [town.ended(operation)["state"] for operation in good] == ["DONE"] * 5
    require_failures()
    # Workers are there again: what comes later is described too.
    assert town.ended(town.posted("later", 9))["state"] == "DONE"
    assert "killed" in ends(town)
    assert all(in_time(pause, 2.5) for pause in respawns_s(town.service))


def test_jobs_without_end_fail_with_their_reasons_and_their_workers_are_replaced(start):
    town = start(workers=2, max_attempts=2, job_timeout_s=2, lease_s=1.5)
    reasons = {
        HANGS: "the job took longer than 2 s",
        # Whichever comes first: the end of the last lease, or the end that the gateway makes of its silent worker.
        HOLDS_EVERY_THREAD: "no worker survived the job: 2 attempts",
    }
    failures(town, reasons)()
    assert {"overtime", "silent"} <= ends(town)
    eventually(lambda: len(town.service.worker_pids()) == 2, "a worker is not replaced")


def test_a_stopped_worker_is_replaced_and_its_late_result_has_no_effect(start, tmp_path):
    gate = tmp_path / "gate"
    town = start(lease_s=1.0, fake_gate=gate)
    ready = town.service.wait_for("worker_ready")
    operation = town.posted("a", 1)
    (stopped,) = town.service.worker_pids()
    eventually(lambda: town.operation(operation)["state"] == "RUNNING")
    os.kill(stopped, signal.SIGSTOP)
    gate.touch()
    done = town.ended(operation)
    assert (done["state"], done["attempts"]) == ("DONE", 2)
    assert not is_running(stopped)
    assert town.service.wait_for("worker_silent")["worker"] == ready["worker"]


@pytest.mark.slow
def test_a_worker_that_stops_while_it_holds_the_database_keeps_the_others_waiting_only_so_long(start, tmp_path):
    town = start(lease_s=1.0, fail="merge.after_loops=sleep@1")
    town.service.wait_for("worker_ready")
    operation, lock = town.posted("a", 1), tmp_path / "home/revisit.db.writer"
    (stopped,) = town.service.worker_pids()
    eventually(lambda: kept_for_long(lock))
    os.kill(stopped, signal.SIGSTOP)
    later = town.posted("b", 2)
    assert (town.ended(operation)["state"], town.ended(later)["state"]) == ("DONE", "DONE")
    assert not is_running(stopped)
    assert town.service.wait_for("worker_silent")["pid"] == stopped


def kept_for_long(lock):
    """Whether a process holds the lock for longer than a transaction takes."""
    try:
        eventually(lambda: is_free(lock), timeout_s=0.2)
    except AssertionError:
        return True
    return False


def test_a_worker_makes_room_for_a_fresh_one_after_its_jobs_and_loses_none(start):
    town = start(jobs_per_worker=2)
    operations = [town.posted(f"s{number}", number) for number in range(3)]
    assert [town.ended(operation)["state"] for operation in operations] == ["DONE"] * 3
    ended = [event for event in town.service.events if event["event"] == "job_ended"]
    assert len({event["worker"] for event in ended}) == 2
    assert all(event["attempt"] == 1 for event in ended)
