"""Evidence for and against joining two groups of sessions, the limits of it, and the reasons that follow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray


class MergeRefusal(StrEnum):
    """Why two groups are not joined."""

    TOO_FEW_LOOPS = "TOO_FEW_LOOPS"
    COMMON_TRACK_TOO_SHORT = "COMMON_TRACK_TOO_SHORT"
    ALIGNMENTS_COMPETE = "ALIGNMENTS_COMPETE"
    OVERLAP_TOO_SMALL = "OVERLAP_TOO_SMALL"
    SURFACES_DISAGREE = "SURFACES_DISAGREE"
    FREE_SPACE_VIOLATED = "FREE_SPACE_VIOLATED"
    ANCHORS_DISAGREE = "ANCHORS_DISAGREE"


@dataclass(frozen=True)
class MergeLimits:
    """Thresholds of the evidence. Lengths in metres.

    loops that agree; the way that they span; rival_share, how many loops a competing alignment may have compared with
    the chosen one; the common points; the median distance of common points from the other's surface; the share of
    points that may stand where the other looked through, over the whole overlap and over each stretch of it.
    """

    loops: int = 3
    common_track_m: float = 10.0
    rival_share: float = 0.25
    common_points: int = 1_000
    median_residual_m: float = 0.15
    seen_through_share: float = 0.054
    stretch_share: float = 0.12

    def scaled(self, scale: float) -> MergeLimits:
        """The limits of a scene of another size: lengths times `scale`."""
        return replace(
            self, common_track_m=self.common_track_m * scale, median_residual_m=self.median_residual_m * scale
        )


CHANGE_REACH_M = 25.0
"""In a scene of the size of a street: farther from the middle of a submap its free space is not relied on."""


DATED_NS = 10**18
"""Stamps before it (2001) are of clocks that do not know the date: they tell the order within a session alone."""


def in_time(session: int, stamp_ns: int) -> tuple[int, int, int]:
    """The place in the order of time of what a session saw at a moment.

    Clocks that do not know the date may begin anew with each session, and two submaps near one place do not tell
    whether they did: sessions of such clocks are in the order of their numbers.
    """
    return (stamp_ns if stamp_ns >= DATED_NS else 0, session, stamp_ns)


SHOWN_STRIDES = 2.0
"""Within so many strides is the map that shows a place last: kept in a square of one, which later versions move."""


def lost_views(
    places_m: NDArray[np.float64], stamps_ns: NDArray[np.int64], gone: NDArray[np.bool_], stride_m: float
) -> int:
    """How many of the neural maps that are `gone` (n,) showed their place last, of those at places (n, 2), metres.

    Another shows a place as late where it is not older and nearer than SHOWN_STRIDES strides.
    """
    kept, kept_ns, near_m = places_m[~gone], stamps_ns[~gone], SHOWN_STRIDES * stride_m
    return sum(
        not (np.linalg.norm(kept[kept_ns >= stamp_ns] - place, axis=1) < near_m).any()
        for place, stamp_ns in zip(places_m[gone], stamps_ns[gone], strict=True)
    )


class ChangeKind(StrEnum):
    """Which day has it: the first one (it vanished) or the second (it appeared).

    MOVED: it vanished elsewhere, where a thing of its size stood. BACK: it had vanished from here on a day before.
    """

    VANISHED = "VANISHED"
    APPEARED = "APPEARED"
    MOVED = "MOVED"
    BACK = "BACK"


Vector = tuple[float, float, float]


@dataclass(frozen=True)
class ChangedThing:
    """A cluster of changed points: a box along the axes of the map around it, centre and extent in metres."""

    kind: ChangeKind
    centre_m: Vector
    extent_m: Vector
    points: int


@dataclass(frozen=True)
class DatedChange:
    """A change that a drive found: its `session`, when it passed, and when the place was seen as it was before.

    `moved_from_m` is where a thing stood that has moved.
    """

    thing: ChangedThing
    session: int
    stamp_ns: int
    before_ns: int
    moved_from_m: Vector | None = None

    def moved_by(self, offset_m: NDArray[np.float64]) -> DatedChange:
        """In a frame whose origin lies at minus `offset_m` (3,) in this one."""
        thing = replace(self.thing, centre_m=_shifted(self.thing.centre_m, offset_m))
        start = None if self.moved_from_m is None else _shifted(self.moved_from_m, offset_m)
        return replace(self, thing=thing, moved_from_m=start)


def _shifted(place: Vector, offset_m: NDArray[np.float64]) -> Vector:
    x, y, z = (np.array(place) + offset_m).tolist()
    return x, y, z


@dataclass(frozen=True)
class MergeEvidence:
    """The evidence for joining two placed groups.

    common_points lie within a resolution of the other group's; residual_m is the median and far_share the share beyond
    half a resolution of their distance from its surface; seen_through_share is the larger of both directions' shares of
    points, among those near the other's submaps, that it looked through; overlap_share is that of common points among
    the points of the submaps that were compared. changes: from the first group to the second, where they were sought.
    worst_stretch_share: the largest seen_through_share of a stretch.
    """

    common_points: int
    residual_m: float
    far_share: float
    seen_through_share: float
    overlap_share: float = 0.0
    changes: tuple[ChangedThing, ...] = ()
    worst_stretch_share: float = 0.0


@dataclass(frozen=True)
class JoiningLoops:
    """The loops between two groups: how many the poses rest on, the way of the second group that they span, metres,
    and how many agree on another alignment.
    """

    loops: int
    common_track_m: float
    rival_loops: int


def loops_refusal(found: JoiningLoops, limits: MergeLimits = MergeLimits()) -> MergeRefusal | None:
    """The first reason that the loops give against joining, None where there is none."""
    reasons = (
        (found.loops < limits.loops and found.rival_loops < limits.loops, MergeRefusal.TOO_FEW_LOOPS),
        (
            found.rival_loops >= limits.rival_share * found.loops and found.rival_loops > 1,
            MergeRefusal.ALIGNMENTS_COMPETE,
        ),
        (found.loops < limits.loops, MergeRefusal.TOO_FEW_LOOPS),
        (found.common_track_m < limits.common_track_m, MergeRefusal.COMMON_TRACK_TOO_SHORT),
    )
    return next((reason for holds, reason in reasons if holds), None)


def surfaces_refusal(evidence: MergeEvidence, limits: MergeLimits = MergeLimits()) -> MergeRefusal | None:
    """The first reason that the surfaces give against joining, None where there is none."""
    reasons = (
        (evidence.common_points < limits.common_points, MergeRefusal.OVERLAP_TOO_SMALL),
        (evidence.residual_m > limits.median_residual_m, MergeRefusal.SURFACES_DISAGREE),
        (evidence.seen_through_share > limits.seen_through_share, MergeRefusal.FREE_SPACE_VIOLATED),
        (evidence.worst_stretch_share > limits.stretch_share, MergeRefusal.FREE_SPACE_VIOLATED),
    )
    return next((reason for holds, reason in reasons if holds), None)
