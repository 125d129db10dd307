"""Steps that may be broken, and loops that such steps may explain: all others the loops in the map speak against.

A step is confirmed where loops in the map close a circle over it and neither it nor the steps beside it are bent, nor
all from one submap at which such a loop ends to the next. A loop that is far off, and whose ends only confirmed steps
and loops in the map join, no broken step explains: a place that is taken for another one, mostly. Thousands of those
would make the search for broken steps dense and endless.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components

from revisit.core.pose_graph.normal_equations import Edges

Array64 = NDArray[np.float64]
Rows = NDArray[np.int64]
Flags = NDArray[np.bool_]

IN_A_ROW, LOOKS_BENT = 5, 15.0
"""Steps in a row, or all from one loop to the next, and their squared distances together, from which on they may be
bent. Where loops are set aside for a bend, each step of it that two sessions share costs about as much as a loop, 11
for either: this is a quarter of it. Of a long bend each costs less; all of them are between two loops that are kept.
"""

BESIDE = 10
"""Steps by which a broken step may lie beside those that are bent for it: loops that agree with one side are kept."""

FAR = 1000.0
"""Squared distance of a loop from the poses, from which on steps that bring it back look bent."""


@dataclass(frozen=True)
class Kept:
    """What is in the map: `steps` of odometry and `loops`, between poses (n, 4, 4)."""

    steps: Edges
    loops: Edges
    poses: Array64

    def unconfirmed(self) -> Flags:
        """Which steps (s,) may be broken: those beside bent ones, and those that no circle of the map leads over."""
        in_a_row, between = self.bends()
        bent = np.convolve(in_a_row > LOOKS_BENT, np.ones(IN_A_ROW))[IN_A_ROW - 1 :][: len(between)] > 0.5
        near = np.convolve(bent | (between > LOOKS_BENT), np.ones(1 + 2 * BESIDE))[BESIDE:][: len(bent)] > 0.5
        return np.asarray(near | bridges(self._ends(), len(self.poses))[: len(self.steps)])

    def bends(self) -> tuple[Array64, Array64]:
        """Squared distances of steps together: of IN_A_ROW that end at each of them, or begin at one (s + 4,), and of
        all with each of them between submaps at which loops end (s,).
        """
        errors = self.steps.squared_errors(self.poses)
        held = np.ones(len(self.poses), dtype=bool)
        held[self.steps.second] = False
        held[self.loops.first] = held[self.loops.second] = True
        stretch = np.cumsum(held)[self.steps.first]
        return np.convolve(errors, np.ones(IN_A_ROW)), np.bincount(stretch, errors)[stretch]

    def may_hold(self, others: Edges) -> Flags:
        """Which of `others` (l,) may be right: where unconfirmed steps are broken, or without that."""
        ends = self._ends()[np.concatenate([~self.unconfirmed(), np.ones(len(self.loops), bool)])]
        part = _parts(ends, len(self.poses))
        return np.asarray((part[others.first] != part[others.second]) | (others.squared_errors(self.poses) < FAR))

    def _ends(self) -> Rows:
        """The poses (s + l, 2) that each step and loop joins, by row."""
        return np.concatenate([_ends(self.steps), _ends(self.loops)])


def bridges(ends: Rows, count: int) -> Flags:
    """Which edges (e,) between `count` nodes `ends` (e, 2) are on no circle: without one its sides fall apart.

    Every edge beside a spanning forest has a random number, and an edge of the forest the exclusive or of those whose
    circles lead over it: zero for a bridge, and for others as good as never.
    """
    roots = np.unique(_parts(ends, count), return_index=True)[1]
    joined = np.concatenate([ends, np.column_stack([np.full(len(roots), count), roots])])  # all parts hang on one more
    links = coo_matrix((np.ones(len(joined)), joined.T), shape=(count + 1, count + 1)).tocsr()
    order, above = breadth_first_order(links, count, directed=False)
    below, above = order[1:].astype(np.int64), above.astype(np.int64)
    known, first = np.unique(_keys(joined, count), return_index=True)
    forest = first[np.searchsorted(known, _keys(np.column_stack([below, above[below]]), count))]
    circles = np.random.default_rng(0).integers(1, 2**62, len(joined))
    circles[forest] = 0
    over = np.zeros(count + 1, np.int64)
    np.bitwise_xor.at(over, joined.ravel(), np.repeat(circles, 2))
    for node in below[::-1]:
        over[above[node]] ^= over[node]
    found = np.zeros(len(joined), bool)
    found[forest] = over[below] == 0
    return found[: len(ends)]


def _keys(ends: Rows, count: int) -> Rows:
    """A number (e,) for the two nodes of each edge, whichever is first; `count` is the largest node."""
    return np.asarray(np.sort(ends, axis=1) @ np.array([count + 1, 1]))


def _ends(edges: Edges) -> Rows:
    return np.column_stack([edges.first, edges.second])


def _parts(ends: Rows, count: int) -> Rows:
    """The number (n,) of the connected part of each of `count` nodes."""
    links = coo_matrix((np.ones(len(ends)), ends.T), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)
