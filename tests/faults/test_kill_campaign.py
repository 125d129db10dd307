"""kill -9 of gateway and workers, and SIGTERM, at random moments, while robots post and stream over both transports."""

from __future__ import annotations

import itertools
import os
import random
import signal
import threading
import time
from collections.abc import Callable

import pytest

from revisit import Client
from tests.faults.history import History, Kind, Outcome
from tests.faults.proxy import BadLink, bad_link
from tests.faults.robots import Crew, Poster, Scanner
from tests.faults.survey import survey
from tests.support.campaigns import Campaign, sizes
from tests.support.processes import ServiceProcess, is_running

SESSION = "maps/town/sessions/monday"
DRAINED_S = 15.0
GATEWAY_EVERY = 5
"""Every so many kills hit the gateway, which takes its workers along; the others hit a worker."""


@pytest.fixture
def service(folder):
    """Workers that die often must not use up the attempts of a job."""
    running = ServiceProcess(folder / "home", workers=2, fake_delay_s=0.01, lease_s=2, max_attempts=1000)
    with Client(running.url) as client:
        client.create_session(client.create_map("town"), "monday")
    yield running
    running.close()


def until(condition: Callable[[], object], what: str, timeout_s: float = 60.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


class Fleet:
    """Robots on links that outlive the service: each repeats what was not acknowledged, under the same id."""

    def __init__(self, http: BadLink, grpc: BadLink) -> None:
        self.history = History()
        self.crew = Crew()
        self.posters = [Poster(f"robot{number}", SESSION, self.history) for number in range(3)]
        # Workers that die all the time fall behind until their queue is full.
        self.scanner = Scanner(SESSION, self.history, frozenset({"WORKERS_BUSY"}))
        self._http, self._grpc = http, grpc

    def start(self) -> None:
        """Two robots post over REST, one over gRPC, one streams scans."""
        for poster, over_grpc in zip(self.posters, (False, False, True), strict=True):
            self.crew.start(self._posting(poster, over_grpc))
        self.crew.start(lambda: self.scanner.stream(self._grpc.address, self.scanner.committed_seq + 20))

    def acknowledged(self) -> int:
        return len(self.history.acknowledged(Kind.PUT))

    def surprises(self) -> list[str]:
        return [problem for client in (*self.posters, self.scanner) for problem in client.surprises]

    def _posting(self, poster: Poster, over_grpc: bool) -> Callable[[], None]:
        numbers = itertools.count()

        def post_one() -> None:
            number = next(numbers)
            submap_id = f"{poster.name}-{number}"
            while self._attempt(poster, over_grpc, submap_id, number % 50) is not Outcome.OK:
                if self.crew.stop.wait(0.05):
                    return

        return post_one

    def _attempt(self, poster: Poster, over_grpc: bool, submap_id: str, place: int) -> Outcome:
        if over_grpc:
            return poster.create(self._grpc.address, submap_id, place)
        return poster.post(f"http://{self._http.address}", submap_id, place)


def start_again(service: ServiceProcess, http: BadLink, grpc: BadLink) -> None:
    service.start()
    http.target, grpc.target = service.url.removeprefix("http://"), service.grpc_target


def kill_gateway(service: ServiceProcess, http: BadLink, grpc: BadLink) -> None:
    """And start it again; its workers notice that it is gone."""
    orphans = service.worker_pids()
    service.kill()
    start_again(service, http, grpc)
    until(lambda: not any(is_running(pid) for pid in orphans), "a worker outlived its gateway")


def kill_worker(service: ServiceProcess, rng: random.Random) -> None:
    until(service.worker_pids, "no worker is started")
    os.kill(rng.choice(service.worker_pids()), signal.SIGKILL)


def worked_off(url: str) -> bool:
    with Client(url) as client:
        return not [submap for submap in client.list_submaps(SESSION) if submap.state == "QUEUED"]


@pytest.mark.parametrize("kills", sizes("KILLS", 25, 1_000))
@pytest.mark.timeout(7200)
def test_what_was_acknowledged_survives_kills_of_gateway_and_workers_once(service, folder, kills):
    rng, moment = random.Random(7), threading.Event()
    with bad_link(service.url.removeprefix("http://")) as http, bad_link(service.grpc_target) as grpc:
        fleet = Fleet(http, grpc)
        fleet.start()
        campaign = Campaign("P1", kills)
        for number in campaign:
            seen = fleet.acknowledged()
            until(lambda seen=seen: fleet.acknowledged() > seen, "nothing is acknowledged any more")
            moment.wait(rng.uniform(0.0, 0.3))
            if number % GATEWAY_EVERY == 0:
                kill_gateway(service, http, grpc)
            else:
                kill_worker(service, rng)
        fleet.crew.end()
        until(lambda: worked_off(service.url), "jobs are left", timeout_s=600.0)
    service.close()
    assert fleet.surprises() == []
    found = survey(folder / "home")
    assert found.against(fleet.history) == []
    assert found.committed["monday"] >= fleet.scanner.committed_seq > 0
    assert set(found.states) == {"DESCRIBED"}
    assert fleet.acknowledged() > campaign.done
    campaign.publish(f"0 of {fleet.acknowledged()} acknowledged lost, 0 twice, index = database")


@pytest.mark.parametrize("drains", sizes("DRAINS", 2, 500))
@pytest.mark.timeout(7200)
def test_a_service_that_is_told_to_end_does_so_in_time_and_keeps_what_it_acknowledged(service, folder, drains):
    rng, moment, took_s = random.Random(13), threading.Event(), []
    with bad_link(service.url.removeprefix("http://")) as http, bad_link(service.grpc_target) as grpc:
        fleet = Fleet(http, grpc)
        fleet.start()
        campaign = Campaign("P13", drains)
        for _ in campaign:
            seen = fleet.acknowledged()
            until(lambda seen=seen: fleet.acknowledged() > seen, "nothing is acknowledged any more")
            moment.wait(rng.uniform(0.0, 0.3))
            workers = service.worker_pids()
            status, ended_s = service.terminate()
            took_s.append(ended_s)
            assert (status, [pid for pid in workers if is_running(pid)]) == (0, [])
            start_again(service, http, grpc)
        fleet.crew.end()
        until(lambda: worked_off(service.url), "jobs are left", timeout_s=600.0)
    service.close()
    assert max(took_s) < DRAINED_S
    assert fleet.surprises() == []
    found = survey(folder / "home")
    assert found.against(fleet.history) == []
    assert set(found.states) == {"DESCRIBED"}
    campaign.publish(f"every exit 0, the slowest after {max(took_s):.1f} s; 0 of {fleet.acknowledged()} lost")
