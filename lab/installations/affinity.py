"""How many places of a job its worker has at hand, simulated: any worker takes it, or one that knows its map."""

from __future__ import annotations

import heapq
from collections import OrderedDict, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from lab.installations.parts import fleet
from lab.installations.queueing import VARIATION, moments_of_robots
from revisit.cli.sizing import need_of, value

PLACES_KEPT = 96
"""Of a worker, unpacked: `PLACES_READ` of `service/adapters/core_recogniser.py`."""

COLD_S = 0.0053
"""More for a place that the worker has not read: 44 ms a job for 8.4 of them (docs/decisions/0366)."""

WAYS_M = 365.0
"""Length of the round that all robots of a map drive: 73 places."""

PASSES = 5
"""Of each place before the first job."""

ASKED = {0: 4, 1: 2, -1: 2, 2: 1, -2: 1}
"""Places that a job compares, by how many steps from its own: so many of the latest views."""

WINDOW = 16
"""Jobs that wait, of which a worker may choose."""


class Claim(StrEnum):
    """A rule by which workers take jobs."""

    ANY = "any worker, the oldest job"
    OWN_FIRST = "a job of the worker's last map before older ones"
    OWN_ONLY = "the map's own worker alone"


@dataclass(frozen=True)
class Job:
    """A submap of a map, with the places that it is compared with."""

    came_s: float
    map_number: int
    asked: tuple[int, ...]


@dataclass
class Worker:
    """A worker with the places that it used last, and the map of its last job."""

    number: int
    places: OrderedDict[int, None] = field(default_factory=OrderedDict)
    last_map: int = -1

    def cold(self, job: Job) -> int:
        """Do a job: how many of its places had to be read."""
        before = len(self.places.keys() & job.asked)
        for place in job.asked:
            self.places[place] = None
            self.places.move_to_end(place)
        while len(self.places) > PLACES_KEPT:
            self.places.popitem(last=False)
        self.last_map = job.map_number
        return len(job.asked) - before

    def chosen(self, claim: Claim, waiting: Sequence[Job], workers: int) -> int | None:
        """The row of the job that it takes next; None where there is none for it."""
        if claim is Claim.OWN_ONLY:
            own = (row for row, job in enumerate(waiting) if job.map_number % workers == self.number)
            return next(own, None)
        if claim is Claim.OWN_FIRST:
            own = (row for row, job in enumerate(waiting[:WINDOW]) if job.map_number == self.last_map)
            return next(own, 0 if waiting else None)
        return 0 if waiting else None


@dataclass(frozen=True)
class Figures:
    """Places that had to be read, for each job, and how long the jobs waited for a worker, seconds."""

    cold: list[int]
    waited_s: list[float]

    def row(self) -> tuple[float, ...]:
        """Mean of the places; mean and 99th percentile of the waits."""
        return (
            float(np.mean(self.cold)),
            float(np.mean(self.waited_s)),
            float(np.quantile(self.waited_s, 0.99)),
        )


def jobs_of(robots: int, maps: int, duration_s: float, rng: np.random.Generator) -> Iterator[Job]:
    """The jobs of robots that drive the rounds of their maps, in the order of their time."""
    gap_s, places = 1.0 / need_of(fleet(1)).submaps_s, round(WAYS_M * need_of(fleet(1)).submaps_s)
    moments, of_robot = moments_of_robots(robots, gap_s, duration_s, rng)
    at = rng.integers(places, size=robots)
    number = maps * places * PASSES
    views = [deque(range(first, first + PASSES), maxlen=PASSES) for first in range(0, number, PASSES)]
    for came_s, robot in zip(moments.tolist(), of_robot.tolist(), strict=True):
        at[robot] = (at[robot] + 1) % places
        own = robot % maps
        near = (views[own * places + (at[robot] + step) % places] for step in ASKED)
        asked = [view for seen, most in zip(near, ASKED.values(), strict=True) for view in list(seen)[-most:]]
        yield Job(came_s, own, tuple(asked))
        views[own * places + at[robot]].append(number)
        number += 1


def simulated(claim: Claim, workers: int, maps: int, busy: float, duration_s: float = 150.0, seed: int = 1) -> Figures:
    """Workers that are `busy` this share of their time with jobs whose places are all at hand, under a rule."""
    rng, takes_s = np.random.default_rng(seed), value("worker_cpu_s_a_submap")
    robots = round(busy * workers / (takes_s * need_of(fleet(1)).submaps_s))
    crew = _Crew([Worker(number) for number in range(workers)], claim, takes_s, rng)
    for job in jobs_of(robots, maps, duration_s, rng):
        crew.work_until(job.came_s)
        crew.offer(job)
    return crew.figures


class _Crew:
    """Workers, the jobs that wait, and the ends of those that run."""

    def __init__(self, workers: list[Worker], claim: Claim, takes_s: float, rng: np.random.Generator) -> None:
        self.figures = Figures([], [])
        self._workers, self._claim, self._takes_s, self._rng = workers, claim, takes_s, rng
        self._idle, self._waiting = set(range(len(workers))), list[Job]()
        self._ends: list[tuple[float, int]] = []

    def work_until(self, now_s: float) -> None:
        """Each worker whose job ends takes the next."""
        while self._ends and self._ends[0][0] <= now_s:
            ended_s, number = heapq.heappop(self._ends)
            self._take(number, ended_s)

    def offer(self, job: Job) -> None:
        """A job comes: of the idle workers, which ask at moments of their own, any may be the first."""
        self._waiting.append(job)
        for number in self._rng.permutation(sorted(self._idle)).tolist():
            self._take(number, job.came_s)

    def _take(self, number: int, now_s: float) -> None:
        worker = self._workers[number]
        row = worker.chosen(self._claim, self._waiting, len(self._workers))
        if row is None:
            self._idle.add(number)
            return
        self._idle.discard(number)
        job = self._waiting.pop(row)
        cold, shape = worker.cold(job), VARIATION**-2
        self.figures.cold.append(cold)
        self.figures.waited_s.append(now_s - job.came_s)
        takes_s = self._rng.gamma(shape, self._takes_s / shape) + COLD_S * cold
        heapq.heappush(self._ends, (now_s + takes_s, number))
