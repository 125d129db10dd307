"""kill -9 and SIGTERM, one step at a time; for kills at random moments see tests/faults/test_kill_campaign.py."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from tests.support.fake_recogniser import KILLS_THE_WORKER
from tests.support.patience import PATIENCE_S, eventually, in_time
from tests.support.processes import ROOT, ServiceProcess, is_running
from tests.support.town import NEVER_TOO_NEAR, SESSION, running_town


@pytest.fixture(scope="module")
def gate(tmp_path_factory):
    """Without this file no description ends. Each test leaves it there."""
    file = tmp_path_factory.mktemp("gate") / "gate"
    file.touch()
    return file


@pytest.fixture(scope="module")
def town(tmp_path_factory, gate):
    """Each test leaves the service running."""
    home = tmp_path_factory.mktemp("town") / "home"
    with running_town(home, fake_delay_s="0.02", fake_gate=gate, of_map=NEVER_TOO_NEAR) as running:
        yield running


def ended(town, beginning):
    """The states of the submaps whose ids begin so, once no submap waits any more."""
    return {name: state for name, state in town.worked_off().items() if name.startswith(beginning)}


def test_an_unfinished_window_of_scans_survives_a_kill(town):
    for seq in range(1, 9):
        assert town.append(seq) == seq
    town.service.kill()
    town.service.start()
    assert town.http.get(f"/v1/{SESSION}").json()["committed_seq"] == "8"
    assert town.append(8) == 8
    for seq in range(9, 17):
        assert town.append(seq) == seq
    assert list(ended(town, "scans")) == ["scans-1-11", "scans-6-16"]


def test_a_submap_that_kills_its_worker_fails_after_three_attempts_and_others_proceed(town):
    poison = town.posted("poison", 1, points=KILLS_THE_WORKER)
    town.posted("good", 2)
    assert ended(town, ("poison", "good")) == {"poison": "FAILED", "good": "DESCRIBED"}
    operation = town.operation(poison)
    assert (operation["state"], operation["attempts"]) == ("FAILED", 3)


def test_a_submap_whose_worker_is_killed_again_and_again_is_described_all_the_same(town, gate):
    gate.unlink()
    operation = town.posted("innocent", 1)
    for run in range(1, 4):  # as often as a guilty one is tried
        eventually(lambda run=run: running_attempt(town, operation) == run, f"run {run} did not begin")
        (worker,) = town.service.worker_pids()
        os.kill(worker, signal.SIGKILL)
    gate.touch()
    ended = town.ended(operation)
    assert (ended["state"], ended["attempts"]) == ("DONE", 4)


@pytest.mark.slow
def test_a_submap_that_was_under_way_when_the_service_was_killed_again_and_again_is_described(tmp_path):
    gate = tmp_path / "gate"
    with running_town(tmp_path / "home", fake_gate=gate, lease_s=1) as town:
        operation = town.posted("innocent", 1)
        for run in range(1, 5):
            eventually(lambda run=run: running_attempt(town, operation) == run, f"run {run} did not begin")
            town.service.kill()
            town.service.start()
        gate.touch()
        ended = town.ended(operation)
        assert (ended["state"], ended["attempts"]) == ("DONE", 5)


def running_attempt(town, operation):
    """The number of the run under way; 0 for none."""
    seen = town.operation(operation)
    return seen["attempts"] if seen["state"] == "RUNNING" else 0


def test_sigterm_drains_and_leaves_no_process(town):
    eventually(town.service.worker_pids, "no worker is started")
    for number in range(5):
        town.posted(f"s{number}", number)
    workers = town.service.worker_pids()
    status, took_s = town.service.terminate()
    assert workers and not any(is_running(pid) for pid in workers)
    assert status == 0 and in_time(took_s, 15.0)
    town.service.start()
    assert set(ended(town, "s").values()) == {"DESCRIBED"}


def test_a_worker_that_is_still_loading_does_not_delay_the_end(tmp_path):
    service = ServiceProcess(tmp_path / "home", fake_load_s=3600)
    try:
        service.wait_for("worker_loading")
        assert service.terminate()[0] == 0
    finally:
        service.close()


def test_an_address_that_others_can_reach_ends_the_start_with_78_and_a_message(tmp_path):
    environment = {**os.environ, "REVISIT_HOME": str(tmp_path), "REVISIT_HOST": "0.0.0.0"}
    command = [sys.executable, "-m", "revisit.service", "serve"]
    ended = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert ended.returncode == 78 and "REVISIT_INSECURE_BIND=1" in ended.stderr
    assert list(tmp_path.iterdir()) == []
