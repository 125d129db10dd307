"""What loops between the same two drives say of each other, by the odometry of both drives.

Each loop puts the odometry frame of one drive beside that of the other. Held against each other all at once: a drive
has hundreds of loops within reach of a submap, and every new one is held against all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.neighbour_support import (
    CONTRADICTING_DRIFT,
    CONTRADICTING_SHARE,
    CONTRADICTING_TURN,
    NeighbourLoop,
)

Array = NDArray[np.float64]
Poses = NDArray[np.float64]


@dataclass(frozen=True)
class DriveSubmap:
    """Where a submap lies on its drive: T_odom_submap (4, 4), metres, and its number on the drive."""

    T_odom_submap: se3.Matrix4
    ordinal: int


@dataclass(frozen=True)
class DriveLoop:
    """A loop between two drives. poses: its hypotheses, each T_match_query (4, 4), the best first, at least one.

    accepted: and not for the sake of other loops.
    """

    query: DriveSubmap
    match: DriveSubmap
    poses: Sequence[se3.Matrix4]
    accepted: bool


class DriveLoops:
    """All loops between the same two drives."""

    def __init__(self, loops: Sequence[DriveLoop], stride_m: float, config: VerificationConfig) -> None:
        """`stride_m`: how far apart neighbouring submaps of a drive were begun."""
        self._loops, self._stride_m, self._config = loops, stride_m, config
        self._T_odom_query = np.array([loop.query.T_odom_submap for loop in loops])
        self._T_odom_match = np.array([loop.match.T_odom_submap for loop in loops])

    def contradicted(self) -> NDArray[np.bool_]:
        """Which loops (n,) cannot be believed, for what the others say of their pairs.

        The first pose of each loop counts. Of two poses that lie apart by more than drift explains, one at least is
        wrong. Which one is not known: a loop stands only where no more than one in five of those that speak of its
        pair, itself included, contradict it (docs/decisions/0214).
        """
        if not self._loops:
            return np.zeros(0, dtype=bool)
        frames = np.array([said[0] for said in self._frames])
        at_query = np.einsum("jab,ib->ija", frames[:, :3, :3], self._T_odom_query[:, :3, 3]) + frames[:, :3, 3]
        apart_m = np.linalg.norm(at_query - at_query.diagonal(axis1=0, axis2=1).T[:, None], axis=2)
        traces = np.einsum("iab,jab->ij", frames[:, :3, :3], frames[:, :3, :3])
        turned = traces < 1.0 + 2.0 * np.cos(CONTRADICTING_TURN)
        against = (apart_m > self._config.rival_distance + CONTRADICTING_DRIFT * self._way_m) | turned
        spoken = self._within_reach.sum(axis=1)
        return np.asarray((against & self._within_reach).sum(axis=1) > CONTRADICTING_SHARE * spoken)

    def neighbours(self, row: int) -> list[NeighbourLoop]:
        """What the loops within reach of that in `row` say of its pair."""
        near = np.flatnonzero(self._within_reach[row]).tolist()
        return [self._neighbour(row, other) for other in near if other != row]

    def has_accepted_neighbour(self, row: int) -> bool:
        """Whether any of `neighbours` is accepted."""
        near = np.flatnonzero(self._within_reach[row]).tolist()
        return any(self._loops[other].accepted for other in near if other != row)

    @cached_property
    def _within_reach(self) -> NDArray[np.bool_]:
        """Which loops odometry carries over to which pairs, (n, n)."""
        return np.asarray(self._way_m <= self._config.support_reach)

    @cached_property
    def _way_m(self) -> Array:
        """The way of both drives together over which odometry carries each pose to each pair, (n, n) metres at least.

        Submaps of a drive lie apart by the crow's flight, and by a stride for each that was begun between them.
        """
        queries = [loop.query.ordinal for loop in self._loops]
        matches = [loop.match.ordinal for loop in self._loops]
        return self._way_on(self._T_odom_query, queries) + self._way_on(self._T_odom_match, matches)

    def _way_on(self, T_odom: Poses, ordinals: Sequence[int]) -> Array:
        position_m, numbers = T_odom[:, :3, 3], np.array(ordinals)
        apart_m = np.linalg.norm(position_m[:, None] - position_m[None], axis=2)
        return np.asarray(np.maximum(apart_m, self._stride_m * np.abs(numbers[:, None] - numbers[None])))

    @cached_property
    def _frames(self) -> list[Poses]:
        """T_odom_match_odom_query of each hypothesis, by loop."""
        T_query_odom = np.linalg.inv(self._T_odom_query)
        return [
            np.array(self._T_odom_match[row] @ np.array(loop.poses) @ T_query_odom[row])
            for row, loop in enumerate(self._loops)
        ]

    def _neighbour(self, row: int, other: int) -> NeighbourLoop:
        poses = se3.inverse(self._T_odom_match[row]) @ self._frames[other] @ self._T_odom_query[row]
        one, told = self._loops[row], self._loops[other]
        query_m, match_m = _ahead_m(one.query, told.query), _ahead_m(one.match, told.match)
        return NeighbourLoop(told.accepted, tuple(poses), query_m, match_m, float(self._way_m[row, other]))


def _ahead_m(submap: DriveSubmap, other: DriveSubmap) -> float:
    """How far ahead `other` lies on the drive of `submap`, as the crow flies; behind it is negative."""
    distance = float(np.linalg.norm(other.T_odom_submap[:3, 3] - submap.T_odom_submap[:3, 3]))
    return distance if other.ordinal > submap.ordinal else -distance
