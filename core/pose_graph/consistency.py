"""Loops between two sessions that agree with each other (pairwise consistency, Mangelson et al. 2018).

Two loops close a circle with the odometry between their ends. The circle of two right loops closes within what the
loops and the drift of the odometry leave open; that of a wrong loop and a right one hardly ever does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.graph import LoopEdge, PoseGraph, Trajectory

Array64 = NDArray[np.float64]
Flags = NDArray[np.bool_]

MAX_CLOSING_ERROR = 33.1
"""All but one in 100,000 right circles close better than this: chi-square with 6 degrees of freedom.

A set of n loops has n (n - 1) / 2 circles, and one that does not close costs it a loop: a gate that loses one circle in
a hundred loses one in four of 30 right loops.
"""

_SEEDS = 32

_CIRCLES_AT_ONCE = 8192
"""Some 1 kB each while they are computed."""


@dataclass(frozen=True)
class ConsistentSet:
    """The loops between two sessions, by their place in the graph, of which every two agree."""

    sessions: tuple[str, str]
    loops: tuple[int, ...]


def consistent_sets(graph: PoseGraph) -> list[ConsistentSet]:
    """The largest consistent set of loops of every two different sessions that share loops."""
    pairs: dict[tuple[str, str], list[int]] = {}
    for number, loop in enumerate(graph.loops):
        if loop.match.session != loop.query.session:
            first, second = sorted((loop.match.session, loop.query.session))
            pairs.setdefault((first, second), []).append(number)
    return [ConsistentSet(pair, _largest_set(graph, pair, rows)) for pair, rows in sorted(pairs.items())]


def _largest_set(graph: PoseGraph, pair: tuple[str, str], rows: list[int]) -> tuple[int, ...]:
    loops = [oriented(graph.loops[row], pair[0]) for row in rows]
    agree = agreement(loops, graph.by_session[pair[0]], graph.by_session[pair[1]])
    return tuple(rows[member] for member in largest_clique(agree))


def oriented(loop: LoopEdge, session: str) -> LoopEdge:
    """The loop with its match in `session`: the same measurement, inverted where it was the other way round."""
    return loop if loop.match.session == session else inverted(loop)


def inverted(loop: LoopEdge) -> LoopEdge:
    """The same measurement with query and match exchanged."""
    T_query_match = se3.inverse(loop.T_match_query)
    return LoopEdge(
        loop.name, loop.query, loop.match, T_query_match, loop.covariance_in_query, loop.independent_share
    )  # fmt: skip


def agreement(loops: list[LoopEdge], first: Trajectory, second: Trajectory) -> Flags:
    """Which of n loops (n, n) agree; the match of each is in `first`, its query in `second`."""
    circles = Circles.of(loops, first, second)
    agree = np.ones((len(loops), len(loops)), dtype=bool)
    others = np.arange(len(loops))
    at_once = max(1, _CIRCLES_AT_ONCE // max(len(loops), 1))
    for start in range(0, len(loops), at_once):
        rows = others[start : start + at_once]
        errors = circles.errors(np.repeat(rows, len(loops)), np.tile(others, len(rows)))
        agree[rows] = errors.reshape(len(rows), len(loops)) < MAX_CLOSING_ERROR
    return np.asarray(agree & agree.T)


@dataclass(frozen=True)
class Circles:
    """Loops between two trajectories, or within one, as the sides of circles.

    T_first_second (n, 4, 4), where each loop puts the odometry frame of `second` in that of `first`; ends (n, 2), the
    ordinals of match and query; variances (n, 2) of translation, m^2, and rotation, rad^2.
    """

    T_first_second: Array64
    ends: NDArray[np.int64]
    variances: Array64
    first: Trajectory
    second: Trajectory

    @classmethod
    def of(cls, loops: list[LoopEdge], first: Trajectory, second: Trajectory) -> Circles:
        """The sides that `loops` make, each with its match in `first` and its query in `second`."""
        ends = np.array([(loop.match.ordinal, loop.query.ordinal) for loop in loops], dtype=np.int64).reshape(-1, 2)
        measured = np.reshape([loop.T_match_query for loop in loops], (-1, 4, 4))
        placed = first.T_odom_submap[ends[:, 0]] @ measured @ np.linalg.inv(second.T_odom_submap[ends[:, 1]])
        diagonals = np.array([np.diagonal(loop.covariance) for loop in loops]).reshape(-1, 2, 3)
        return cls(placed, ends, diagonals.mean(axis=2), first, second)

    def errors(self, rows: NDArray[np.int64], others: NDArray[np.int64]) -> Array64:
        """Squared errors (m,), in variances, with which the circles of loops `rows` (m,) with `others` (m,) close.

        Both loops place the submap of `second` at the end of the loop in `rows` in the odometry of `first`; what they
        differ by is measured there, so that a far origin of an odometry frame does not count.
        """
        positions, of_rows, of_others = self.second.T_odom_submap[:, :3, 3], self.ends[rows], self.ends[others]
        here, mine, theirs = positions[of_rows[:, 1]], self.T_first_second[rows], self.T_first_second[others]
        apart = np.einsum("nij,nj->ni", theirs[:, :3, :3] - mine[:, :3, :3], here) + theirs[:, :3, 3] - mine[:, :3, 3]
        trace = np.einsum("nij,nij->n", theirs[:, :3, :3], mine[:, :3, :3])
        angle = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
        translation, rotation = (self.variances[rows] + self.variances[others]).T
        lever = ((positions[of_others[:, 1]] - here) ** 2).sum(axis=1)
        translation = translation + self.variances[others, 1] * lever
        for side, trajectory in enumerate((self.first, self.second)):
            of_position, of_rotation = trajectory.drift(of_others[:, side], of_rows[:, side])
            translation, rotation = translation + of_position, rotation + of_rotation
        return np.asarray((apart**2).sum(axis=1) / translation + angle**2 / rotation)


def largest_clique(agree: Flags) -> list[int]:
    """Members, ascending, of a large set of which every two agree: greedy, from the members with most partners.

    The largest set is not found for certain (that is NP-hard); among right loops nearly all agree, and then it is.
    """
    agree = agree & ~np.eye(len(agree), dtype=bool)
    degree = agree.sum(axis=1)
    best: list[int] = [int(degree.argmax())] if len(agree) else []
    for seed in np.argsort(-degree, kind="stable")[:_SEEDS]:
        if degree[seed] + 1 <= len(best):
            break
        members, candidates = [int(seed)], np.flatnonzero(agree[seed])
        among = agree[np.ix_(candidates, candidates)]
        while len(candidates) and len(members) + len(candidates) > len(best):
            chosen = int(among.sum(axis=1).argmax())
            members.append(int(candidates[chosen]))
            left = among[chosen]
            candidates, among = candidates[left], among[np.ix_(left, left)]
        if len(members) > len(best):
            best = members
    return sorted(best)
