"""One episode: a new service with robots, mishaps by a seed, and a look at everything that was acknowledged."""

from __future__ import annotations

import random
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path

import httpx

from tests.faults.faulty_disk import FaultyDisk
from tests.faults.fleet import Fleet, fleet_of
from tests.faults.history import Kind, Operation, Outcome
from tests.faults.preloaded import SteppedWallClock, launcher
from tests.faults.robots import EXPECTED, Poster, content
from tests.support.next_migration import add_next_step
from tests.support.patience import eventually
from tests.support.processes import ROOT, ServiceProcess
from tests.support.source_copies import copied_packages

PAUSE_S = 0.2
"""Between two posts of a robot."""

NOT_THERE = frozenset({404})
"""To whom posts into a session that somebody deletes."""

OF_A_BAD_DISK = frozenset({422, 507})
COVARIANCE = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]

NACKS = frozenset({"WORKERS_BUSY", "STORAGE_FULL", "STORAGE_UNCERTAIN"})

MISTAKEN = (400, 405, 422, 500)

ENDS_BY_ITSELF = (74, 75)
"""Exit statuses of a gateway whose disk has failed."""

UNFINISHED = (
    "SELECT (SELECT count(*) FROM jobs WHERE state IN ('QUEUED', 'RUNNING')) + (SELECT count(*) FROM deletions)"
)


class Upgradable(ServiceProcess):
    """The service on a disk and a clock with troubles; after `upgrade` it is that of the next release."""

    def __init__(self, home: Path, disk: FaultyDisk, clock: SteppedWallClock) -> None:
        self.launcher = launcher(disk, clock)
        self.upgraded = False
        super().__init__(home, workers=2, fake_delay_s=0.01, lease_s=2, max_attempts=1000, max_queued_jobs=10**6)

    def upgrade(self, folder: Path) -> None:
        """From the next start on it runs the code in `folder`."""
        self.folder, self.upgraded = folder, True


class Episode:
    """A running service, the robots of maps/town, an operator, and the second map `yard`, which has no robots."""

    def __init__(self, folder: Path, fleet: Fleet, disk: FaultyDisk, clock: SteppedWallClock, seed: str) -> None:
        self.folder, self.fleet, self.disk, self.clock = folder, fleet, disk, clock
        self.rng = random.Random(seed)
        self.home = folder / "home"
        self.answers: Counter[str] = Counter()
        """The operator's calls: name and status of each answer."""
        self.surprises: list[str] = []
        self.backups: list[tuple[Path, frozenset[int]]] = []
        self.yard: dict[str, list[str]] = {}
        """Sessions of the yard, with the ids of the submaps that were sent there."""
        self.anchors: dict[str, list[str]] = {}
        """The ids of the anchors that were sent for sessions of the yard."""
        self.posters: list[Poster] = []
        self._ids = 0

    @property
    def service(self) -> Upgradable:
        """That of the robots."""
        service = self.fleet.service
        assert isinstance(service, Upgradable)
        return service

    def call(
        self, method: str, path: str, timeout_s: float = 20.0, known: str = "", **given: object
    ) -> httpx.Response | None:
        """A call of the operator; None without an answer. What tells of a mistake is a surprise, but for a reason that
        is `known`.
        """
        name = f"{method} {path.rpartition(':')[2] if ':' in path else path.split('/')[-1][:3]}"
        try:
            with httpx.Client(verify=False, trust_env=False, timeout=timeout_s) as client:
                answer = client.request(method, f"{self.service.url}/v1/{path}", json=given or None)
        except httpx.HTTPError:
            self.answers[f"{name} none"] += 1
            return None
        self.answers[f"{name} {answer.status_code}"] += 1
        if answer.status_code in MISTAKEN and not (known and known in answer.text):
            self.surprises.append(f"{method} {path}: {answer.status_code} {answer.text}")
        return answer

    def new_id(self, of: str) -> str:
        """An id that nothing has yet."""
        self._ids += 1
        return f"{of}{self._ids}"

    def post_aside(self, session_id: str, places: list[int]) -> None:
        """Post these places into a session of the yard, once each."""
        history = self.fleet.history
        expected = EXPECTED | OF_A_BAD_DISK | NOT_THERE
        poster = Poster("operator", f"maps/yard/sessions/{session_id}", history, expected)
        self.posters.append(poster)
        for place in places:
            submap_id = self.new_id("y")
            self.yard.setdefault(session_id, []).append(submap_id)
            poster.post(self.service.url, submap_id, place)

    def anchor(self, session_id: str, count: int) -> None:
        """Post so many anchors on earth for a session of the yard."""
        history, sent = self.fleet.history, []
        for _ in range(count):
            anchor_id, stamp_ns = self.new_id("a"), self.rng.randrange(1, 100)
            position = (48.0, 11.0 + 1e-6 * stamp_ns, 500.0)
            self.anchors.setdefault(session_id, []).append(anchor_id)
            fields = {"anchor_id": anchor_id, "kind": "GNSS", "stamp_ns": stamp_ns, "covariance_enu": COVARIANCE}
            at = dict(zip(("latitude_deg", "longitude_deg", "altitude_m"), position, strict=True))
            place = {"geodetic": at, "T_odom_sensor": "0,0,0,0,0,0,1"}
            operation = history.invoke("operator", Kind.PUT, f"anchor/{anchor_id}", str(position))
            sent.append((operation, {**fields, **place}))
        asked, anchors = f"maps/yard/sessions/{session_id}/anchors", [one for _, one in sent]
        outcome = _outcome(self.call("POST", asked, anchors=anchors))
        if outcome is Outcome.UNKNOWN:  # a repeated request has its effect once, and tells of nothing but itself
            again = _outcome(self.call("POST", asked, anchors=anchors))
            outcome = again if again is Outcome.OK else outcome
        for operation, _ in sent:
            history.settle(operation, outcome)

    def remove_anchor(self, session_id: str, anchor_id: str) -> None:
        """Delete an anchor of a session of the yard."""
        self.anchors[session_id].remove(anchor_id)
        self.remove(f"maps/yard/sessions/{session_id}/anchors/{anchor_id}", [f"anchor/{anchor_id}"])

    def remove(self, path: str, keys: list[str]) -> None:
        """Delete something that takes these submaps and anchors with it."""
        history = self.fleet.history
        operations = [history.invoke("operator", Kind.DELETE, one) for one in keys]
        answer = self.call("DELETE", path)
        status = answer.status_code if answer is not None else 0
        for operation in operations:
            # What was not there when it was asked for may have come since.
            history.settle(operation, Outcome.OK if status in (200, 204) else Outcome.UNKNOWN)

    def read(self, path: str, submap_id: str) -> None:
        """Look a submap up, and note what is there."""
        history = self.fleet.history
        operation = history.invoke("operator", Kind.READ, f"submap/{submap_id}")
        answer = self.call("GET", path)
        if answer is not None and answer.status_code == 200:
            history.settle(operation, Outcome.OK, content(int(answer.json()["stamp_ns"])))
        elif answer is not None and answer.status_code == 404:
            history.settle(operation, Outcome.OK)

    def may_go(self, submap_ids: list[str]) -> None:
        """Whether these submaps are kept is left open from now on."""
        for submap_id in submap_ids:
            self.fleet.history.invoke("operator", Kind.DELETE, f"submap/{submap_id}")

    def until_it_runs(self) -> None:
        """Start the service again where it has ended for its disk; any other end is a surprise."""
        if self.service.ended is None:
            return
        if self.service.ended not in ENDS_BY_ITSELF:
            self.surprises.append(f"the service ended with {self.service.ended}: {self.service.other_lines[-5:]}")
        self.service.close()
        self.fleet.start_again()

    def is_served(self) -> None:
        """Wait until something is acknowledged again."""
        self.until_it_runs()
        seen = self.fleet.acknowledged()

        def acknowledged() -> bool:
            self.until_it_runs()
            return self.fleet.acknowledged() > seen

        eventually(acknowledged, "nothing is acknowledged any more")

    def unfinished(self) -> int:
        """Jobs and deletions that are not done."""
        with closing(sqlite3.connect(f"file:{self.home}/revisit.db?mode=ro", uri=True)) as rows:
            return int(rows.execute(UNFINISHED).fetchone()[0])

    def next_release(self) -> Path:
        """The code with one step of the schema more."""
        copy = self.folder / "next"
        copied_packages(ROOT, copy)
        add_next_step(copy / "migrations")
        return copy

    def known_now(self) -> frozenset[int]:
        """The operations that a backup which begins now must show; what is under way may be in it or not."""
        return frozenset(id(one) for one in self.fleet.history.operations if one.outcome is not Outcome.UNKNOWN)


def _outcome(answer: httpx.Response | None) -> Outcome:
    """The outcome of a request by its answer (P2)."""
    if answer is None or answer.status_code >= 500:
        return Outcome.UNKNOWN
    return Outcome.OK if answer.status_code == 200 else Outcome.FAIL


def as_of(known: frozenset[int], operations: list[Operation]) -> list[Operation]:
    """The operations as they were when only these were `known`: the effect of every other one is open."""
    changes = [one for one in operations if one.kind in (Kind.PUT, Kind.DELETE)]
    return [
        one
        if id(one) in known or one.outcome is Outcome.FAIL
        else replace(one, outcome=Outcome.UNKNOWN, settled_at=float("inf"))
        for one in changes
    ]


@contextmanager
def episode(folder: Path, seed: str) -> Iterator[Episode]:
    """A new service with its robots at work."""
    folder.mkdir(parents=True)
    disk, clock = (
        FaultyDisk(folder / "home", folder, seed=random.Random(seed).randrange(10**6)),
        SteppedWallClock(folder),
    )
    with ExitStack() as stack:
        service = stack.enter_context(closing(Upgradable(folder / "home", disk, clock)))
        fleet = stack.enter_context(fleet_of(service, EXPECTED | OF_A_BAD_DISK, NACKS))
        fleet.pause_s = PAUSE_S
        made = Episode(folder, fleet, disk, clock, seed)
        made.call("POST", "maps", map_id="yard")
        fleet.set_out()
        try:
            yield made
        finally:
            fleet.crew.stop.set()
            (folder / "service.log").write_text("\n".join(map(str, [*service.events, *service.other_lines])))
