"""Loops within a session: which of them the odometry allows, and which have others beside them that agree.

A session has a start that its loops share, so that one loop alone can be held against the odometry between its ends.
And a robot that comes back to a road sees it over many submaps: a right loop has others beside it that say the same.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from revisit.core.pose_graph.consistency import MAX_CLOSING_ERROR, Circles, inverted, oriented
from revisit.core.pose_graph.graph import LoopEdge, PoseGraph, Trajectory

Array64 = NDArray[np.float64]

BESIDE = 10
"""Submaps by which the ends of two loops may be apart for one to support the other."""

STRETCH = 20
"""Submaps of a stretch of which one loop speaks for all that agree with it, where loops are more than submaps."""

_QUARTER = 0.25
_SLACK = 100.0
"""How much worse than typical circles (the lower quartile of places) one may close: stated covariances can be far too
large, and the circles that close best show it.
"""


@dataclass(frozen=True)
class LoopsWithin:
    """Loops within sessions, by index in the graph: those that odometry allows, and of these the supported ones.

    Of a session with more supported loops than submaps, some speak for others that agree with them: wrong loops join
    everything with everything, and the equations of thousands of them are dense (docs/decisions/0274). `speakers` has,
    by number, those that each of them speaks for, itself among them.
    """

    allowed: frozenset[int]
    supported: frozenset[int]
    speakers: dict[int, tuple[int, ...]]

    @classmethod
    def of(cls, graph: PoseGraph) -> LoopsWithin:
        """Every loop within a session, held against its odometry and against the loops beside it."""
        allowed: list[int] = []
        supported: list[int] = []
        speakers: dict[int, tuple[int, ...]] = {}
        for trajectory in graph.trajectories:
            rows, loops = loops_within(graph, trajectory)
            circles = Circles.of(loops, trajectory, trajectory)
            fits = np.flatnonzero(odometry_errors(circles) < MAX_CLOSING_ERROR)
            allowed += rows[fits].tolist()
            borne = fits[have_support(circles, fits)]
            supported += rows[borne].tolist()
            if len(borne) > len(trajectory):
                speakers |= {int(rows[group[0]]): tuple(rows[group].tolist()) for group in stretches(circles, borne)}
        return cls(frozenset(allowed), frozenset(supported), speakers)


def supported_loops(graph: PoseGraph) -> frozenset[int]:
    """The loops of the graph, by number, that close a small circle with another one; far odometry is not asked."""
    groups: dict[tuple[str, str], list[int]] = {}
    for number, loop in enumerate(graph.loops):
        first, second = sorted((loop.match.session, loop.query.session))
        groups.setdefault((first, second), []).append(number)
    found: list[int] = []
    for (first, second), numbers in groups.items():
        loops = [graph.loops[number] for number in numbers]
        turned = [_forward(one) if first == second else oriented(one, first) for one in loops]
        circles = Circles.of(turned, graph.by_session[first], graph.by_session[second])
        found += itertools.compress(numbers, have_support(circles, np.arange(len(numbers))))
    return frozenset(found)


def loops_within(graph: PoseGraph, trajectory: Trajectory) -> tuple[NDArray[np.int64], list[LoopEdge]]:
    """The loops within a session, by their place in the graph, each with the earlier submap as its match."""
    rows = [number for number, loop in enumerate(graph.loops) if _is_within(loop, trajectory)]
    return np.array(rows, dtype=np.int64), [_forward(graph.loops[row]) for row in rows]


def _is_within(loop: LoopEdge, trajectory: Trajectory) -> bool:
    return loop.match.session == loop.query.session == trajectory.session


def _forward(loop: LoopEdge) -> LoopEdge:
    """The loop with the earlier submap as its match."""
    return loop if loop.match.ordinal < loop.query.ordinal else inverted(loop)


def odometry_errors(circles: Circles) -> Array64:
    """Squared distances (n,), in variances, of loops within a session from the odometry between their ends."""
    at = circles.second.T_odom_submap[circles.ends[:, 1], :3, 3]
    turn, shift = circles.T_first_second[:, :3, :3], circles.T_first_second[:, :3, 3]
    moved = np.einsum("nij,nj->ni", turn, at) + shift - at
    angle = np.arccos(np.clip(0.5 * (np.trace(turn, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    variances = circles.variances + np.stack(circles.second.drift(circles.ends[:, 0], circles.ends[:, 1]), axis=1)
    return np.asarray((moved**2).sum(axis=1) / variances[:, 0] + angle**2 / variances[:, 1])


def have_support(circles: Circles, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of the loops `rows` (n,) close a small circle with another one of them."""
    if len(rows) < 2:
        return np.zeros(len(rows), dtype=bool)
    beside = _beside(circles, rows)
    least = np.full(len(rows), np.inf)
    for side in (0, 1):
        np.minimum.at(least, beside.pairs[:, side], beside.errors)
    slack = _SLACK * _typical(least, _places(circles, rows, beside))
    return np.asarray(least <= min(MAX_CLOSING_ERROR, slack))


def _typical(least: Array64, places: NDArray[np.int64]) -> float:
    """How well the best circles (n,) of loops close, as a quarter of the `places` (n,) where there are any do.

    Never the best place alone: neighbours that take it for another one repeat one measurement.
    """
    closing = np.isfinite(least)
    of_places = [np.quantile(least[closing & (places == one)], _QUARTER) for one in np.unique(places[closing])]
    return float(np.quantile(of_places, _QUARTER, method="higher")) if of_places else 0.0


def stretches(circles: Circles, rows: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """The loops `rows` (n,) by runs, which small circles hold together, and stretches of STRETCH submaps."""
    runs = _beside(circles, rows).runs(len(rows))
    _, group = np.unique(np.column_stack([runs, circles.ends[rows, 1] // STRETCH]), axis=0, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    return np.split(rows[order], np.flatnonzero(np.diff(group.ravel()[order])) + 1)


def places(circles: Circles, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """The number (n,) of the place where each of the loops `rows` (n,) was found: a run, or STRETCH submaps of it.

    Neighbours that agree with each other show one place, and are one mistake where it is taken for another one: a place
    has one vote. A run is counted from its own beginning, so that a short one is never two places.
    """
    return _places(circles, rows, _beside(circles, rows))


def joined_stretches(loops: Sequence[LoopEdge]) -> NDArray[np.int64]:
    """The number (n,) of the two stretches that each loop joins, whichever is its match: a place in any graph."""
    keys = [sorted((node.session, node.ordinal // STRETCH) for node in (one.match, one.query)) for one in loops]
    numbers: dict[tuple[tuple[str, int], ...], int] = {}
    return np.array([numbers.setdefault(tuple(key), len(numbers)) for key in keys], dtype=np.int64)


def votes(places: NDArray[np.int64]) -> Array64:
    """The votes of some members of `places` (n,): those of a place have one vote together."""
    return np.asarray(1.0 / np.bincount(places)[places])


@dataclass(frozen=True)
class _Beside:
    """Pairs (m, 2) of loops with both ends beside each other, and how their circles close (m,), in variances."""

    pairs: NDArray[np.int64]
    errors: Array64

    def runs(self, count: int) -> NDArray[np.int64]:
        """The number (n,) of the run of each of `count` loops: small circles hold it together."""
        one, other = self.pairs[self.errors < MAX_CLOSING_ERROR].T
        links = coo_matrix((np.ones(len(one)), (one, other)), shape=(count, count))
        return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def _beside(circles: Circles, rows: NDArray[np.int64]) -> _Beside:
    pairs = cKDTree(circles.ends[rows]).query_pairs(BESIDE, p=np.inf, output_type="ndarray")
    return _Beside(pairs, circles.errors(rows[pairs[:, 0]], rows[pairs[:, 1]]))


def _places(circles: Circles, rows: NDArray[np.int64], beside: _Beside) -> NDArray[np.int64]:
    runs, ends = beside.runs(len(rows)), circles.ends[rows]
    begins = np.full((int(runs.max(initial=-1)) + 1, 2), np.iinfo(np.int64).max)
    np.minimum.at(begins, runs, ends)
    _, group = np.unique(np.column_stack([runs, (ends - begins[runs]) // STRETCH]), axis=0, return_inverse=True)
    return np.asarray(group.ravel(), dtype=np.int64)
