"""Waiting lines, simulated customer by customer: the database as one server, workers as many."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lab.installations.parts import SCANS_S, commit_s, fleet, job_s
from revisit.cli.sizing import need_of, value

Floats = NDArray[np.float64]

JITTER = 0.2
"""Of the time between two scans of a robot: its speed is not steady."""


VARIATION = 0.3
"""Of the time that a submap takes a worker: standard deviation over mean. Assumed."""


@dataclass(frozen=True)
class Waits:
    """Seconds from a scan to its acknowledgement, and from the end of a submap to its loops."""

    acknowledged_s: Floats
    found_s: Floats

    def row(self) -> tuple[float, ...]:
        """Median and 99th percentile of both."""
        return tuple(
            float(np.quantile(of, share)) for of in (self.acknowledged_s, self.found_s) for share in (0.5, 0.99)
        )


def arrivals(robots: int, gap_s: float, duration_s: float, rng: np.random.Generator) -> Floats:
    """Moments, in order, at which robots that began at any time send something every `gap_s` or so."""
    return moments_of_robots(robots, gap_s, duration_s, rng)[0]


def moments_of_robots(
    robots: int, gap_s: float, duration_s: float, rng: np.random.Generator
) -> tuple[Floats, NDArray[np.int64]]:
    """These moments, and which robot sends at each."""
    count = int(duration_s / gap_s)
    gaps = gap_s * rng.uniform(1 - JITTER, 1 + JITTER, (robots, count))
    moments = (rng.uniform(0, gap_s, (robots, 1)) + np.cumsum(gaps, axis=1)).ravel()
    order = np.argsort(moments, kind="stable")
    return moments[order], order // count


def served(arrive_s: Floats, service_s: Floats, servers: int) -> Floats:
    """When each customer leaves a first-come line before `servers` equal servers, seconds."""
    free = [0.0] * servers
    left = np.empty_like(arrive_s)
    for number, (came, takes) in enumerate(zip(arrive_s.tolist(), service_s.tolist(), strict=True)):
        left[number] = max(came, heapq.heappop(free)) + takes
        heapq.heappush(free, float(left[number]))
    return left


def waits(robots: int, workers: int, duration_s: float = 120.0, seed: int = 1) -> Waits:
    """An installation under `robots` with `workers` cores for describing, from an empty start."""
    rng, submaps_s = np.random.default_rng(seed), need_of(fleet(1)).submaps_s
    scans = arrivals(robots, 1.0 / SCANS_S, duration_s, rng)
    submaps = arrivals(robots, 1.0 / submaps_s, duration_s, rng)
    acknowledged, stored = _committed(scans, submaps, rng)
    shape = VARIATION**-2
    takes = rng.gamma(shape, value("worker_cpu_s_a_submap") / shape, len(submaps))
    return Waits(acknowledged - scans, served(np.sort(stored), takes, workers) - submaps)


def _committed(scans: Floats, jobs: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """When scans and jobs are committed by a database that serves them one after the other."""
    moments = np.concatenate([scans, jobs])
    means = np.repeat([commit_s(), job_s()], [len(scans), len(jobs)])
    order = np.argsort(moments, kind="stable")
    left = np.empty_like(moments)
    left[order] = served(moments[order], rng.exponential(means[order]), 1)
    return left[: len(scans)], left[len(scans) :]
