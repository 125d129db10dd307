"""kill -9 of gateway and workers, and SIGTERM, at random moments, while robots post and stream over both transports."""

from __future__ import annotations

import contextlib
import os
import random
import signal
from contextlib import closing

import pytest

from tests.faults.fleet import Fleet, fleet_of
from tests.support.campaigns import Campaign, sizes
from tests.support.patience import eventually, in_time
from tests.support.processes import ServiceProcess, is_running

DRAINED_S = 15.0
GATEWAY_EVERY = 10
"""Every so many kills hit the gateway, which takes its workers along; the others hit a worker."""


@pytest.fixture
def fleet(folder):
    """As it is shipped, but for the method: workers that die often must not use up the attempts of a job."""
    settings = {"workers": 2, "fake_delay_s": 0.01}
    with closing(ServiceProcess(folder / "home", **settings)) as service, fleet_of(service) as robots:
        yield robots


def kill_gateway(fleet: Fleet) -> None:
    """And start it again; its workers notice that it is gone."""
    orphans = fleet.service.worker_pids()
    fleet.service.kill()
    fleet.start_again()
    eventually(lambda: not any(is_running(pid) for pid in orphans), "a worker outlived its gateway")


def kill_worker(fleet: Fleet, rng: random.Random) -> None:
    pids: list[int] = []
    eventually(lambda: pids.extend(fleet.service.worker_pids()) or pids, "no worker is started")
    with contextlib.suppress(ProcessLookupError):  # it may have ended by itself just now
        os.kill(rng.choice(pids), signal.SIGKILL)


@pytest.mark.parametrize("kills", sizes("KILLS", 3, 1_000))
@pytest.mark.timeout(7200)
def test_what_was_acknowledged_survives_kills_of_gateway_and_workers_once(fleet, folder, kills):
    rng, campaign = random.Random(17), Campaign("P1", kills)
    for number in fleet.moments(campaign, seed=7):
        if number % GATEWAY_EVERY == 0:
            kill_gateway(fleet)
        else:
            kill_worker(fleet, rng)
    found = fleet.require_kept(folder / "home")
    assert set(found.states) == {"DESCRIBED"}, (found.states, campaign.done, found.failures)
    assert fleet.scanner.committed_seq > 0
    assert fleet.acknowledged() > campaign.done
    campaign.publish(f"0 of {fleet.acknowledged()} acknowledged lost, 0 twice, index = database")


@pytest.mark.parametrize("drains", sizes("DRAINS", 1, 500))
@pytest.mark.timeout(7200)
def test_a_service_that_is_told_to_end_does_so_in_time_and_keeps_what_it_acknowledged(fleet, folder, drains):
    took_s, campaign = [], Campaign("P13", drains)
    for _ in fleet.moments(campaign, seed=13):
        workers = fleet.service.worker_pids()
        status, ended_s = fleet.service.terminate()
        took_s.append(ended_s)
        assert (status, [pid for pid in workers if is_running(pid)]) == (0, [])
        fleet.start_again()
    assert in_time(max(took_s), DRAINED_S)
    assert set(fleet.require_kept(folder / "home").states) == {"DESCRIBED"}
    campaign.publish(f"every exit 0, the slowest after {max(took_s):.1f} s; 0 of {fleet.acknowledged()} lost")
