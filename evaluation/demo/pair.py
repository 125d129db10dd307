"""The pair of submaps that closed the loop which odometry had wrong most, for the picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.evaluation.demo.truth import FoundLoop, JudgedLoop, TrueSubmap

Array = NDArray[np.float32]


@dataclass(frozen=True)
class ClosingPair:
    """Two submaps of one robot: where odometry has the query in the frame of the match, and where the loop has it."""

    loop: FoundLoop
    T_match_query_odometry: se3.Matrix4

    @property
    def gap_m(self) -> float:
        """How far apart the two poses put the query, metres."""
        return float(np.linalg.norm((self.T_match_query_odometry - self.loop.T_match_query)[:3, 3]))


@dataclass(frozen=True)
class PairClouds:
    """The pair with the points of both submaps (n, 3) and (m, 3), each in the frame of its own submap."""

    pair: ClosingPair
    query: Array
    match: Array


def closing_pair(
    loops: Sequence[JudgedLoop], submaps: Mapping[str, TrueSubmap], T_odom_submap: Mapping[str, se3.Matrix4]
) -> ClosingPair | None:
    """Of the true loops of one robot with itself the one that odometry had wrong most; None where there is none."""
    within = [
        judged.loop
        for judged in loops
        if not judged.false and submaps[judged.loop.query].robot == submaps[judged.loop.match].robot
    ]
    pairs = [ClosingPair(one, se3.inverse(T_odom_submap[one.match]) @ T_odom_submap[one.query]) for one in within]
    return max(pairs, key=lambda pair: (pair.gap_m, pair.loop.query, pair.loop.match), default=None)


def standing(points: Array, clearance_m: float = 0.6, cell_m: float = 4.0) -> Array:
    """The points (n, 3) more than `clearance_m` above the lowest one of their cell, thus not on the ground."""
    cells = np.floor(points[:, :2] / cell_m).astype(np.int64)
    keys = cells[:, 0] * 1_000_003 + cells[:, 1]
    _, cell = np.unique(keys, return_inverse=True)
    lowest = np.full(cell.max(initial=0) + 1, np.inf)
    np.minimum.at(lowest, cell, points[:, 2])
    return np.asarray(points[points[:, 2] > lowest[cell] + clearance_m])
