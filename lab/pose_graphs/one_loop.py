"""One loop more in a large map: how long the correction takes, and how far it is from a whole new optimisation."""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lab.pose_graphs.benchmark import rms_distance
from revisit.core.geometry import se3
from revisit.core.pose_graph.graph import GraphState, LoopEdge, Node, OdometryModel, PoseGraph, Trajectory
from revisit.core.pose_graph.optimisation import Robustness, optimise
from revisit.core.pose_graph.warm_start import SolvedComponent

SESSION = "drive"
STEP_M = 5.0
BLOCK_STEPS = 20
LEAST_SPAN = 30
"""Submaps between the ends of a loop."""

LOOP_COVARIANCE = np.diag([0.1**2] * 3 + [np.radians(0.5) ** 2] * 3)
_HEADINGS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])


@dataclass(frozen=True)
class OneLoopTimes:
    """CPU milliseconds of the loops (n,), and how many of them the map took; CPU seconds that the first factorisation
    takes; root mean square distance from a whole new plain optimisation, metres.
    """

    poses: int
    loops: int
    cpu_ms: NDArray[np.float64]
    taken: int
    first_s: float
    distance_m: float

    @property
    def median_ms(self) -> float:
        """The median loop."""
        return float(np.median(self.cpu_ms))

    @property
    def p95_ms(self) -> float:
        """95 of 100 loops take no longer."""
        return float(np.quantile(self.cpu_ms, 0.95))


def run(poses: int = 10_000, loops: int = 100, seed: int = 0) -> OneLoopTimes:
    """Solve a made-up drive without some of its loops, then take these in one by one."""
    graph = grid_drive(poses, seed)
    late = set(np.random.default_rng(seed + 1).choice(len(graph.loops), loops, replace=False).tolist())
    early = PoseGraph.of(list(graph.trajectories), [loop for n, loop in enumerate(graph.loops) if n not in late])
    known = optimise(early, Robustness.PLAIN).T_map_submap
    started = time.process_time()
    solved = SolvedComponent(early, known, range(len(early.loops)), SESSION)
    first_s = time.process_time() - started
    taken, cpu_ms = 0, []
    for number in sorted(late):
        started = time.process_time()
        taken += solved.add(graph.loops[number]) is GraphState.IN_MAP
        cpu_ms.append(1e3 * (time.process_time() - started))
        if solved.is_half_full:
            solved.refresh()
    moved = np.stack([solved.T_map_submap(Node(SESSION, n)) for n in range(poses)])
    distance_m = rms_distance({SESSION: moved}, optimise(graph, Robustness.PLAIN).T_map_submap)
    return OneLoopTimes(poses, len(early.loops), np.array(cpu_ms), taken, first_s, distance_m)


def grid_drive(poses: int, seed: int, blocks: int = 14) -> PoseGraph:
    """A made-up drive at random through a square grid of streets; every second submap on a known street is a loop."""
    rng = np.random.default_rng(seed)
    places, headings = _streets(poses, blocks, rng)
    jitter = rng.normal(0.0, 0.5, (poses, 2))
    truth = np.stack([
        se3.from_yaw(0.5 * np.pi * heading, (*(STEP_M * place + aside), 0.0))
        for place, heading, aside in zip(places, headings, jitter, strict=True)
    ])  # fmt: skip
    steps = [se3.inverse(one) @ other for one, other in itertools.pairwise(truth)]
    lengths_m = np.array([np.linalg.norm(step[:3, 3]) for step in steps])
    odometry = [truth[0]]
    for step, covariance in zip(steps, OdometryModel().covariances(lengths_m), strict=True):
        odometry.append(odometry[-1] @ step @ _error(covariance, rng))
    loops = []
    for n, (match, query) in enumerate(_revisits(places, rng)):
        measured = _error(LOOP_COVARIANCE, rng) @ se3.inverse(truth[match]) @ truth[query]
        loops.append(LoopEdge(f"{n:05d}", Node(SESSION, match), Node(SESSION, query), measured, LOOP_COVARIANCE))
    return PoseGraph.of([Trajectory.from_odometry(SESSION, np.stack(odometry))], loops)


def _streets(poses: int, blocks: int, rng: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Places (n, 2) in steps and headings (n,) in quarters of a turn: straight on, left or right at every corner."""
    corner, heading = np.array([blocks // 2, blocks // 2]), 0
    places: list[NDArray[np.int64]] = []
    headings: list[int] = []
    while len(places) < poses:
        ways = [(heading + turn) % 4 for turn in (-1, 0, 1)]
        inside = [way for way in ways if ((corner + _HEADINGS[way] >= 0) & (corner + _HEADINGS[way] <= blocks)).all()]
        heading = int(rng.choice(inside))
        for step in range(BLOCK_STEPS):
            places.append(BLOCK_STEPS * corner + step * _HEADINGS[heading])
            headings.append(heading)
        corner = corner + _HEADINGS[heading]
    return np.array(places[:poses]), np.array(headings[:poses])


def _revisits(places: NDArray[np.int64], rng: np.random.Generator) -> list[tuple[int, int]]:
    """Match and query of the loops: every second submap with one of the earlier ones at its place."""
    seen: dict[tuple[int, ...], list[int]] = {}
    found = []
    for query, place in enumerate(places):
        known = seen.setdefault(tuple(place.tolist()), [])
        if known and query % 2 == 0 and query - known[-1] > LEAST_SPAN:
            found.append((int(rng.choice(known)), query))
        known.append(query)
    return found


def _error(covariance: NDArray[np.float64], rng: np.random.Generator) -> se3.Matrix4:
    return se3.exp(rng.normal(size=6) * np.sqrt(np.diag(covariance)))
