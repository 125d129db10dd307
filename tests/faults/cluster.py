"""An installation on two hosts, robots that post to it, and the faults that befall it."""

from __future__ import annotations

import itertools
import os
import random
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from revisit.formats import KITTI, encode_kitti
from tests.faults.other_host import OtherHost, possible
from tests.faults.stored_loops import ALIKE, Store
from tests.support.fake_recogniser import BINS
from tests.support.postgres import PostgresServer, new_folder
from tests.support.processes import SearchProcess, ServiceProcess, WorkersProcess, _Logging
from tests.support.service_world import cloud_points

PLACES, VISITS = 12, 15
"""Places that robots see in turn, and how often, before others follow: less often than a search has candidates."""

MOST_PLACES = 400
"""Of all robots together in one campaign."""

ROBOTS = 3
SETTINGS = {
    "secret": "s" * 40,
    "lease_s": 5.0,
    "max_attempts": 1000,
    "fake_delay_s": 0.02,
    "optimise_after_loops": 0,
    "insecure_bind": 1,
    "max_queued_jobs": 10**6,
}
NOT_NOW = 75
ANSWERED_S = 20.0
PAUSE_S = 3.0
"""Between two posts of a robot: workers that are killed must keep up."""

HOUR_S = 3600
CUT_S = (1.0, 20.0)
"""How long a cable is out: shorter and longer than leases, and than processes count as living."""


class Robot:
    """Posts submap after submap to gateways by chance, each again until it is acknowledged."""

    def __init__(self, number: int, gateways: list[ServiceProcess], stop: threading.Event) -> None:
        self.acknowledged: dict[str, int] = {}
        self.surprises: list[str] = []
        self.gateways, self._number, self._stop = gateways, number, stop
        self.thread = threading.Thread(target=self._drive, daemon=True)

    def _drive(self) -> None:
        for count in itertools.count():
            submap_id, place = f"r{self._number}-{count}", _place(count * ROBOTS + self._number)
            while not self._posted(submap_id, place):
                if self._stop.wait(0.1):
                    return
            self.acknowledged[submap_id] = place
            if self._stop.wait(PAUSE_S):
                return

    def _posted(self, submap_id: str, place: int) -> bool:
        gateway = random.choice(self.gateways)
        asked = {"submap_id": submap_id, "stamp_ns": place, "T_odom_submap": f"{place},0,0,0,0,0,1"}
        body, headers = encode_kitti(cloud_points(place)), {"Content-Type": KITTI}
        try:
            url = f"{gateway.url}/v1/maps/town/sessions/robot{self._number}/submaps"
            answer = httpx.post(
                url, params=asked, content=body, headers=headers, timeout=ANSWERED_S, trust_env=False, verify=False
            )
        except httpx.TransportError:
            return False
        if answer.status_code not in (200, 202, 429, 503, 504):
            self.surprises.append(answer.text)
        return answer.status_code in (200, 202)


def _place(number: int) -> int:
    """The place that a submap of all robots together shows."""
    return lone_places()[number % PLACES + PLACES * (number // (PLACES * VISITS))]


@cache
def lone_places() -> list[int]:
    """Places no two of which are alike: of twins a query would meet more than a search has candidates, and which of
    those are compared, chance tells.
    """
    found, descriptors = list[int](), np.zeros((MOST_PLACES, BINS))
    for place in itertools.count():
        counts, _ = np.histogram(cloud_points(place)[:, 2], bins=BINS, range=(-8.0, 8.0))
        descriptor = counts / np.linalg.norm(counts)
        if (descriptors @ descriptor).max() < ALIKE:
            descriptors[len(found)] = descriptor
            found.append(place)
        if len(found) == MOST_PLACES:
            return found
    raise AssertionError


def acknowledged_to(robots: list[Robot]) -> set[str]:
    """The submaps that these were told are stored. Raises AssertionError where they got an answer of another kind."""
    assert [surprise for robot in robots for surprise in robot.surprises] == []
    return {name for robot in robots for name in robot.acknowledged}


def make_sessions(gateway: ServiceProcess) -> None:
    """The map and a session for each robot; a drive need not leave a place there."""
    with httpx.Client(base_url=gateway.url, trust_env=False) as client:
        assert client.post("/v1/maps", json={"map_id": "town", "leave_distance_m": 0}).is_success
        for number in range(ROBOTS):
            made = client.post("/v1/maps/town/sessions", json={"session_id": f"robot{number}"})
            assert made.is_success, made.text


class Cluster:
    """Three gateways, eight workers of two hosts and two search processes over one database and one folder of blobs.

    Without `other` the second host is this one, too, and its cable and clock are left alone.
    """

    def __init__(self, home: Path, server: PostgresServer, other: OtherHost | None, stack: ExitStack) -> None:
        self.server, self.other, url = server, other, server.made_database()
        self.store = Store(url)
        here: dict[str, Any] = {**SETTINGS, "database_url": url.render_as_string(hide_password=False)}
        here |= {"host": other.here} if other else {}
        there: dict[str, Any] = here
        if other:
            there = {**here, "host": other.address, "database_url": server.url_from_afar(url).render_as_string()}

        def started(kind: type[_Logging], number: int, **settings: Any) -> _Logging:
            apart = other is not None and number == 0
            made = _on(kind, other) if apart else kind
            return stack.enter_context(closing(made(home, **(there if apart else here), **settings)))

        self.gateways = [started(ServiceProcess, number, workers=0) for number in (1, 2, 0)]
        self.workers = [started(WorkersProcess, number, workers=4) for number in range(2)]
        self.searches = [started(SearchProcess, number) for number in range(2)]
        self.faults: Counter[str] = Counter()
        self.recoveries_s: list[tuple[float, str]] = []

    def write_logs(self, folder: Path) -> None:
        """What each process has logged, in a file of its own."""
        for role in ("gateways", "workers", "searches"):
            for number, process in enumerate(getattr(self, role)):
                lines = [*map(str, process.events), *process.other_lines]
                (folder / f"{role}-{number}.log").write_text("\n".join(lines))

    def supervise(self) -> None:
        """Start again what ended since the database was away when it began; nothing else ends by itself."""
        for process in (*self.gateways, *self.workers, *self.searches):
            assert process.ended in (None, NOT_NOW), (process.command, process.ended, process.events[-3:])
            if process.ended == NOT_NOW:
                process.close()
                process.start()

    def strike(self, rng: random.Random) -> str:
        """One fault by chance, and what is needed that the installation may get over it."""
        chances: dict[Callable[[random.Random], str], int] = {
            self._kill_process: 6, self._kill_worker: 3, self._restart_database: 1,
        }  # fmt: skip
        if self.other:
            chances |= {self._pull_the_cable: 1, self._step_the_clock: 1}
        fault = rng.choices(list(chances), list(chances.values()))[0](rng)
        self.faults[fault] += 1
        return fault

    def _kill_process(self, rng: random.Random) -> str:
        role = rng.choice(("gateway", "host of workers", "search"))
        processes = {"gateway": self.gateways, "host of workers": self.workers, "search": self.searches}[role]
        process = rng.choice(processes)
        process.send(signal.SIGKILL)
        process.close()
        process.start()
        return role

    def _kill_worker(self, rng: random.Random) -> str:
        pids = [pid for host in self.workers for pid in host.worker_pids()]
        with suppress(ProcessLookupError, IndexError):  # all of them may be starting
            os.kill(rng.choice(pids), signal.SIGKILL)
        return "worker"

    def _restart_database(self, rng: random.Random) -> str:
        how = rng.choice((signal.SIGKILL, signal.SIGINT))
        self.server.stop(how)
        time.sleep(rng.uniform(0.0, 2.0))
        self.server.start()
        return "database"

    def _pull_the_cable(self, rng: random.Random) -> str:
        assert self.other is not None
        self.other.cut()
        time.sleep(rng.uniform(*CUT_S))
        self.other.plug()
        return "cable"

    def _step_the_clock(self, rng: random.Random) -> str:
        assert self.other is not None
        self.other.step(rng.choice((-HOUR_S, 0, HOUR_S)))
        return "clock"


@contextmanager
def cluster_in(folder: Path) -> Iterator[Cluster]:
    """One on two hosts, where this machine can be made into two; the database is on the first. Logs: `folder`."""
    with ExitStack() as stack:
        other = stack.enter_context(closing(OtherHost(folder))) if possible() else None
        apart = {"listens": other.here, "network": other.network} if other else {}
        server = PostgresServer(new_folder(), sync=True, **apart)
        stack.callback(server.end)
        server.start()
        made = Cluster(folder / "home", server, other, stack)
        stack.callback(made.write_logs, folder)
        yield made


def _on(kind: type[_Logging], host: OtherHost) -> type[_Logging]:
    """A process of this kind on the other host."""
    return type(f"Other{kind.__name__}", (kind,), {"launcher": host.launcher})
