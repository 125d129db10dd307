"""Robots that post and stream while a service is killed, drained or has a bad disk, and what must be true then."""

from __future__ import annotations

import itertools
import random
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from revisit import Client
from revisit.service.ports.blobs import BlobStore
from tests.faults.history import History, Kind, Outcome
from tests.faults.proxy import BadLink, bad_link
from tests.faults.robots import EXPECTED, Crew, Poster, Scanner
from tests.faults.survey import Survey, survey
from tests.support.campaigns import Campaign
from tests.support.patience import eventually
from tests.support.processes import ServiceProcess
from tests.support.town import SESSION

PLACES = 50
PAUSE_S = 0.05
"""After an attempt: a gateway that ends is not to be asked a thousand times, and one that starts needs the cores."""


class Robot:
    """Posts one submap after another over its transport, each again and again under the same id."""

    def __init__(self, fleet: Fleet, number: int, *, over_grpc: bool) -> None:
        """`open` are the submaps whose fate the robot has not been told, with their places."""
        self.poster = Poster(f"robot{number}", SESSION, fleet.history, fleet.expected)
        self.open: dict[str, int] = {}
        self._fleet, self._over_grpc, self._numbers = fleet, over_grpc, itertools.count()

    def post_next(self, attempts: int = 10**9) -> tuple[str, int]:
        """Post one until it is acknowledged, `attempts` are used up or the robots are to stop: its id and place."""
        number = next(self._numbers)
        submap_id, place = f"{self.poster.name}-{number}", number % PLACES
        self.open[submap_id] = place
        for _ in range(attempts):
            if self.attempt(submap_id, place) is Outcome.OK:
                del self.open[submap_id]
                self._fleet.crew.stop.wait(self._fleet.pause_s)
                break
            if self._fleet.crew.stop.wait(self._fleet.pause_s):
                break
        return submap_id, place

    def attempt(self, submap_id: str, place: int, *points: int) -> Outcome:
        """Post it once."""
        if self._over_grpc:
            return self.poster.create(self._fleet.grpc.address, submap_id, place, *points)
        return self.poster.post(f"http://{self._fleet.http.address}", submap_id, place, *points)


class Fleet:
    """Two robots over REST, one over gRPC and one that streams scans, on links that outlive the service."""

    pause_s = PAUSE_S

    def __init__(
        self, service: ServiceProcess, http: BadLink, grpc: BadLink, expected: frozenset[int], nacks: frozenset[str]
    ) -> None:
        """A refusal that is not `expected`, or a Nack that is none of `nacks`, is a surprise."""
        self.service, self.http, self.grpc, self.expected = service, http, grpc, expected
        self.history, self.crew = History(), Crew()
        self.robots = [Robot(self, number, over_grpc=number == 2) for number in range(3)]
        self.scanner = Scanner(SESSION, self.history, nacks)

    def set_out(self, work: Callable[[Robot], object] = Robot.post_next) -> None:
        """Every robot does its `work` again and again."""
        self.crew = Crew()
        for robot in self.robots:
            self.crew.start(lambda robot=robot: work(robot))
        self.crew.start(self._stream)

    def moments(self, campaign: Campaign, seed: int) -> Iterator[int]:
        """Set out; the rounds of a campaign, each a random while after another acknowledgement; come home again."""
        rng, pause = random.Random(seed), threading.Event()
        self.set_out()
        for number in campaign:
            seen = self.acknowledged()
            eventually(lambda seen=seen: self.acknowledged() > seen, "nothing is acknowledged any more")
            pause.wait(rng.uniform(0.0, 0.3))
            yield number
        self.crew.end()
        self.work_off()

    def start_again(self) -> None:
        """Start the service, on other ports, where the links lead to from now on."""
        self.service.start()
        self.http.target, self.grpc.target = self.service.url.removeprefix("http://"), self.service.grpc_target

    def work_off(self) -> None:
        """Wait until every submap has been described."""
        with Client(self.service.url) as client:
            eventually(lambda: "QUEUED" not in {s.state for s in client.list_submaps(SESSION)}, "jobs are left", 600.0)

    def acknowledged(self) -> int:
        """How many submaps and scans were."""
        return len(self.history.acknowledged(Kind.PUT))

    def require_kept(self, home: Path, blobs: BlobStore | None = None) -> Survey:
        """End the service. All that was acknowledged is in `home`, once, no answer was a surprise: what is there."""
        self.service.close()
        found, clients = survey(home, blobs=blobs), (*(robot.poster for robot in self.robots), self.scanner)
        wrong = found.against(self.history) + [problem for client in clients for problem in client.surprises]
        assert not wrong, wrong
        assert found.committed["monday"] >= self.scanner.committed_seq, found.committed
        return found

    def _stream(self) -> None:
        self.scanner.stream(self.grpc.address, self.scanner.committed_seq + 20)
        self.crew.stop.wait(self.pause_s)


@contextmanager
def fleet_of(
    service: ServiceProcess,
    expected: frozenset[int] = EXPECTED,
    nacks: frozenset[str] = frozenset({"WORKERS_BUSY"}),
) -> Iterator[Fleet]:
    """The robots of a service, in a session of their own. Workers that often die fall behind until a queue is full."""
    with Client(service.url) as client:
        client.create_session(client.create_map("town"), "monday")
    with bad_link(service.url.removeprefix("http://")) as http, bad_link(service.grpc_target) as grpc:
        yield Fleet(service, http, grpc, expected, nacks)
