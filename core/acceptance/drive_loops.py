"""Consistency of loops between the same two drives, by the odometry of both.

Each loop puts the odometry frame of one drive beside that of the other. Held against each other all at once: a drive
has hundreds of loops within reach of a submap, and every new one is held against all of them. A loop within one drive
is held against the odometry of that drive, too. Heights are held to the drift of both odometries
(docs/decisions/0214).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from revisit.core.acceptance.claim import LoopClaim, Station
from revisit.core.acceptance.height_drift import allowed_rises_m, height_drift
from revisit.core.acceptance.neighbour_support import NeighbourLoop, agrees
from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3

Array = NDArray[np.float64]
Poses = NDArray[np.float64]


class DriveLoops:
    """All claims between the same two drives; each must say a pose."""

    def __init__(self, loops: Sequence[LoopClaim], stride_m: float, config: VerificationConfig) -> None:
        """`stride_m`: how far apart neighbouring submaps of a drive were begun."""
        self._loops, self._stride_m, self._config = loops, stride_m, config
        self._T_odom_query = np.array([loop.query.T_odom_submap for loop in loops])
        self._T_odom_match = np.array([loop.match.T_odom_submap for loop in loops])

    @cached_property
    def refuted(self) -> NDArray[np.bool_]:
        """Loops (n,) of one drive that its odometry refutes: it may be poor, but it is no lie."""
        if not self._loops:
            return np.zeros(0, dtype=bool)
        off = self._at_query.diagonal(axis1=0, axis2=1).T - self._T_odom_query[:, :3, 3]
        far = np.linalg.norm(off, axis=1) > self._config.rival_distance + _LONG_DRIFT * self._own_way_m
        risen = np.abs(off[:, 2]) > allowed_rises_m(self._own_way_m, self._height_drift) + _SURE * self._height_m
        of_one = np.array([loop.of_one_drive for loop in self._loops])
        return np.asarray(of_one & (far | (risen & (self._own_way_m <= _FAR_HEIGHTS * self._config.support_reach))))

    def contradicted(self) -> NDArray[np.bool_]:
        """Loops (n,) that the others contradict.

        The first pose of each loop counts. Of two poses that lie apart by more than drift explains, one at least is
        wrong. Which one is not known: a loop stands only where no more than one in five of those that speak of its
        pair, itself included, contradict it; asked once of those nearby, and once of those far along the drives, too.
        """
        if not self._loops:
            return np.zeros(0, dtype=bool)
        reach_m = self._config.support_reach
        return np.asarray(self._outvoted(reach_m) | self._outvoted(_FAR_REACHES * reach_m))

    def other_poses(self, row: int) -> list[se3.Matrix4]:
        """Other poses T_match_query of the pair in `row`: by its own odometry, by loops beside it.

        Poses that are one, once.
        """
        T_match_odom, T_odom_query = se3.inverse(self._T_odom_match[row]), self._T_odom_query[row]
        found = [(T_match_odom @ T_odom_query, np.inf)] if self.refuted[row] else []
        against = np.flatnonzero(self._against[row] & self._speaks[row]).tolist()
        for other in sorted(against, key=lambda one: float(self._way_m[row, one])):
            pose = T_match_odom @ self._frames[other][0] @ T_odom_query
            allowed_m, rise_m = float(self._allowed_m[row, other]), float(self._allowed_rise_m[row, other])
            up = self._T_odom_match[row, 2, :3]
            if all(_differ(pose, one, up, allowed_m, min(rise_m, at_m)) for one, at_m in found):
                found.append((pose, rise_m))
        return [pose for pose, _ in found]

    def neighbours(self, row: int) -> list[NeighbourLoop]:
        """Poses of the pair in `row` by the loops within reach."""
        return [self._neighbour(row, other) for other in self._near(row)]

    def agrees_with_any(self, row: int, which: Sequence[bool]) -> bool:
        """Whether the first pose of the loop in `row` is that of any of its neighbours of `which` (n,)."""
        T_match_query = self._loops[row].hypotheses[0]
        firsts = (self._neighbour(row, other).with_first() for other in self._near(row) if which[other])
        return any(agrees(T_match_query, one, self._config) for one in firsts)

    def has_accepted_neighbour(self, row: int) -> bool:
        """Whether any of `neighbours` is accepted."""
        return any(self._loops[other].accepted_by_itself for other in self._near(row))

    def _near(self, row: int) -> list[int]:
        return [other for other in np.flatnonzero(self._within_reach[row]).tolist() if other != row]

    @cached_property
    def _within_reach(self) -> NDArray[np.bool_]:
        """Which loops odometry carries over to which pairs, (n, n)."""
        return np.asarray(self._way_m <= self._config.support_reach)

    def _outvoted(self, reach_m: float) -> NDArray[np.bool_]:
        speaks = self._speaks & (self._way_m <= reach_m)
        return np.asarray((self._against & speaks).sum(axis=1) > _CONTRADICTING_SHARE * speaks.sum(axis=1))

    @cached_property
    def _speaks(self) -> NDArray[np.bool_]:
        """Which loop (second) says anything of the pair of which (first), itself included."""
        speaks = (self._way_m <= _FAR_REACHES * self._config.support_reach) & ~self.refuted
        np.fill_diagonal(speaks, True)
        return speaks

    @cached_property
    def _against(self) -> NDArray[np.bool_]:
        """Which loop (second) says otherwise of the pair of which (first). Headings drift: far away none counts."""
        rotations = self._first_frames[:, :3, :3]
        traces = np.einsum("iab,jab->ij", rotations, rotations)
        turned = (traces < 1.0 + 2.0 * np.cos(_CONTRADICTING_TURN)) & self._within_reach
        own = self._at_query.diagonal(axis1=0, axis2=1).T
        shifted = np.linalg.norm(self._at_query - own[:, None], axis=2) > self._allowed_m
        return np.asarray(shifted | (self._rise_m > self._allowed_rise_m) | turned)

    @cached_property
    def _allowed_m(self) -> Array:
        """So far apart two right loops may put a query, (n, n) metres."""
        near_m = np.minimum(self._way_m, self._config.support_reach)
        drift_m = _CONTRADICTING_DRIFT * near_m + _LONG_DRIFT * (self._way_m - near_m)
        return np.asarray(self._config.rival_distance + drift_m)

    @cached_property
    def _allowed_rise_m(self) -> Array:
        """So far apart in height two right loops may put a query, (n, n) metres."""
        unsure_m = np.hypot(self._height_m[:, None], self._height_m[None])
        return allowed_rises_m(self._way_m, self._height_drift) + _SURE * unsure_m

    @cached_property
    def _height_m(self) -> Array:
        return np.array([loop.height_m for loop in self._loops])

    @cached_property
    def _height_drift(self) -> float:
        """How far both odometries may drift apart in height, a metre of way."""
        return height_drift(self._rise_m, self._way_m)

    @cached_property
    def _rise_m(self) -> Array:
        """How far apart in height each loop (second) and its own (first) put the query of each, (n, n) metres."""
        heights = self._at_query[..., 2]
        return np.asarray(np.abs(heights - heights.diagonal()[:, None]))

    @cached_property
    def _at_query(self) -> Array:
        """Where each loop (second) puts the query of each (first) in the odometry frame of the matches, (n, n, 3)."""
        frames = self._first_frames
        turned = np.einsum("jab,ib->ija", frames[:, :3, :3], self._T_odom_query[:, :3, 3])
        return np.asarray(turned + frames[:, :3, 3])

    @cached_property
    def _first_frames(self) -> Poses:
        return np.array([said[0] for said in self._frames])

    @cached_property
    def _own_way_m(self) -> Array:
        """The way (n,) between the two submaps of each loop, where they are of one drive."""
        apart_m = np.linalg.norm(self._T_odom_query[:, :3, 3] - self._T_odom_match[:, :3, 3], axis=1)
        ordinals = np.array([loop.query.ordinal - loop.match.ordinal for loop in self._loops])
        return least_way_m(apart_m, ordinals, self._stride_m)

    @cached_property
    def _way_m(self) -> Array:
        """The way of both drives over which odometry carries each pose to each pair, (n, n) metres at least."""
        queries, matches = [loop.query for loop in self._loops], [loop.match for loop in self._loops]
        return ways_m(queries, self._stride_m) + ways_m(matches, self._stride_m)

    @cached_property
    def _frames(self) -> list[Poses]:
        """T_odom_match_odom_query of each hypothesis, by loop."""
        return frames_between(self._loops, [loop.hypotheses for loop in self._loops])

    def _neighbour(self, row: int, other: int) -> NeighbourLoop:
        poses = se3.inverse(self._T_odom_match[row]) @ self._frames[other] @ self._T_odom_query[row]
        one, neighbour = self._loops[row], self._loops[other]
        query_m, match_m = _ahead_m(one.query, neighbour.query), _ahead_m(one.match, neighbour.match)
        return NeighbourLoop(
            neighbour.accepted_by_itself, tuple(poses), query_m, match_m, float(self._way_m[row, other])
        )


def frames_between(claims: Sequence[LoopClaim], poses: Sequence[Sequence[se3.Matrix4]]) -> list[Poses]:
    """T_odom_match_odom_query (p, 4, 4) of each of the `poses` T_match_query of each claim."""
    T_query_odom = np.linalg.inv([claim.query.T_odom_submap for claim in claims])
    return [
        np.array(claim.match.T_odom_submap @ np.array(poses[row]) @ T_query_odom[row])
        for row, claim in enumerate(claims)
    ]


def ways_m(submaps: Sequence[Station], stride_m: float) -> Array:
    """At least so many metres of way lie between each two of these submaps (n,) of a drive, (n, n)."""
    position_m = np.array([one.T_odom_submap[:3, 3] for one in submaps])
    ordinals = np.array([one.ordinal for one in submaps])
    apart_m = np.linalg.norm(position_m[:, None] - position_m[None], axis=2)
    return least_way_m(apart_m, ordinals[:, None] - ordinals[None], stride_m)


def least_way_m(apart_m: ArrayLike, ordinals_apart: ArrayLike, stride_m: float) -> Array:
    """At least so many metres of way lie between submaps of a drive, all of one shape.

    They lie apart by the crow's flight, and by a stride for each that was begun between them.
    """
    return np.maximum(apart_m, stride_m * np.abs(ordinals_apart))


def _ahead_m(submap: Station, other: Station) -> float:
    """How far ahead `other` lies on the drive of `submap`, as the crow flies; behind it is negative."""
    distance = float(np.linalg.norm(other.T_odom_submap[:3, 3] - submap.T_odom_submap[:3, 3]))
    return distance if other.ordinal > submap.ordinal else -distance


def _differ(one: se3.Matrix4, other: se3.Matrix4, up: Array, allowed_m: float, allowed_rise_m: float) -> bool:
    """Whether two poses (4, 4) in one frame, of which `up` (3,) is the vertical, are two."""
    apart = one[:3, 3] - other[:3, 3]
    moved = float(np.linalg.norm(apart)) > allowed_m or abs(float(up @ apart)) > allowed_rise_m
    return moved or se3.rotation_angle(se3.inverse(one) @ other) > _CONTRADICTING_TURN


_CONTRADICTING_SHARE = 0.2
_CONTRADICTING_DRIFT = 0.05  # a poor odometry; right loops must not contradict each other
_CONTRADICTING_TURN = np.radians(10.0)
_LONG_DRIFT = 0.1  # its heading drifts, too
_FAR_REACHES = 6.0
_SURE = 3.0  # standard deviations
_FAR_HEIGHTS = 2.0  # a pitch that walks without gravity bends a longer way
