"""A submap that ruins its worker harms only itself: crash, endless job, held interpreter, memory, a stopped worker."""

from __future__ import annotations

import os
import signal
import time
from datetime import datetime

import httpx
import pytest

from revisit.formats import KITTI, encode_kitti
from tests.support.fake_recogniser import EATS_MEMORY, HANGS, HOLDS_EVERY_THREAD, SEGFAULTS
from tests.support.processes import ServiceProcess, is_free, is_running
from tests.support.service_world import cloud_points

SESSION = "/v1/maps/town/sessions/monday"


@pytest.fixture
def start(tmp_path):
    started = []

    def begin(**settings):
        started.append(ServiceProcess(tmp_path / "home", **settings))
        with httpx.Client(base_url=started[0].url, timeout=10) as client:
            assert client.post("/v1/maps", json={"map_id": "town"}).status_code == 201
            assert client.post("/v1/maps/town/sessions", json={"session_id": "monday"}).status_code == 201
        return started[0]

    yield begin
    for service in started:
        service.close()


def post(service, submap_id, place, points=300):
    parameters = {"submap_id": submap_id, "stamp_ns": place, "T_odom_submap": f"{place},0,0,0,0,0,1"}
    body = encode_kitti(cloud_points(place, points))
    with httpx.Client(base_url=service.url, timeout=10) as client:
        answer = client.post(f"{SESSION}/submaps", params=parameters, content=body, headers={"Content-Type": KITTI})
    assert answer.status_code == 202, answer.text
    return answer.json()["operation"]["name"]


def ended(service, operation, timeout_s=120.0):
    """The operation once it has ended."""
    deadline = time.monotonic() + timeout_s
    with httpx.Client(base_url=service.url, timeout=70) as client:
        while time.monotonic() < deadline:
            found = client.get(f"/v1/{operation}:wait", params={"timeout_s": 5}).json()
            if found["state"] in ("DONE", "FAILED"):
                return found
    raise AssertionError(f"still {found['state']} after {timeout_s} s: {service.events[-10:]}")


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


REASONS = {
    SEGFAULTS: "2 attempts, the last one ended because its worker was ended by signal 11 (Segmentation fault)",
    HANGS: "the job took longer than 5 s",
    EATS_MEMORY: "the job needs more memory than a worker may take",
    # Whichever comes first: the end of the last lease, or the end that the gateway makes of its silent worker.
    HOLDS_EVERY_THREAD: "no worker survived the job: 2 attempts",
}


def test_poison_submaps_fail_with_their_reasons_and_others_are_described(start):
    service = start(workers=2, max_attempts=2, job_timeout_s=5, lease_s=1.5, worker_memory_mb=512)
    poison = {mischief: post(service, f"poison{mischief}", mischief, mischief) for mischief in REASONS}
    good = [post(service, f"good{number}", number) for number in range(5)]
    assert [ended(service, operation)["state"] for operation in good] == ["DONE"] * 5
    for mischief, operation in poison.items():
        failed = ended(service, operation)
        assert (failed["state"], failed["attempts"]) == ("FAILED", 2)
        assert REASONS[mischief] in failed["failure"]["message"]
    # Workers are there again: what comes later is described too.
    assert ended(service, post(service, "later", 9))["state"] == "DONE"
    ends = {event["end"] for event in service.events if event["event"] == "worker_ended"}
    assert {"killed", "overtime", "silent"} <= ends
    assert all(pause < 2.5 for pause in respawns_s(service))


def test_a_stopped_worker_is_replaced_and_its_late_result_has_no_effect(start):
    service = start(lease_s=1.0, fake_delay_s=1.0)
    ready = service.wait_for("worker_ready")
    operation = post(service, "a", 1)
    (stopped,) = service.worker_pids()
    wait_until_running(service, operation)
    os.kill(stopped, signal.SIGSTOP)
    done = ended(service, operation)
    assert (done["state"], done["attempts"]) == ("DONE", 2)
    assert not is_running(stopped)
    silent = service.wait_for("worker_silent")
    assert silent["worker"] == ready["worker"]


def test_a_worker_that_stops_while_it_holds_the_database_keeps_the_others_waiting_only_so_long(start, tmp_path):
    service = start(lease_s=1.0, fail="merge.after_loops=sleep@1")
    service.wait_for("worker_ready")
    operation = post(service, "a", 1)
    (stopped,) = service.worker_pids()
    wait_until_kept(tmp_path / "home/revisit.db.writer")
    os.kill(stopped, signal.SIGSTOP)
    later = post(service, "b", 2)  # asserts that it is taken in
    assert (ended(service, operation)["state"], ended(service, later)["state"]) == ("DONE", "DONE")
    assert not is_running(stopped)
    assert service.wait_for("worker_silent")["pid"] == stopped


def wait_until_kept(lock, timeout_s=10.0):
    """Until a process keeps the lock longer than a transaction takes."""
    deadline, in_a_row = time.monotonic() + timeout_s, 0
    while in_a_row < 10:
        assert time.monotonic() < deadline
        in_a_row = 0 if is_free(lock) else in_a_row + 1
        time.sleep(0.02)


def wait_until_running(service, operation, timeout_s=10.0):
    deadline = time.monotonic() + timeout_s
    with httpx.Client(base_url=service.url, timeout=10) as client:
        while client.get(f"/v1/{operation}").json()["state"] != "RUNNING":
            assert time.monotonic() < deadline
            time.sleep(0.02)


def test_a_worker_makes_room_for_a_fresh_one_after_its_jobs_and_loses_none(start):
    service = start(jobs_per_worker=2)
    operations = [post(service, f"s{number}", number) for number in range(5)]
    assert [ended(service, operation)["state"] for operation in operations] == ["DONE"] * 5
    workers = {event["worker"] for event in service.events if event["event"] == "job_ended"}
    assert len(workers) == 3
    assert all(event["attempt"] == 1 for event in service.events if event["event"] == "job_ended")
