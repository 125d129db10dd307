"""Undecided faults of odometry: the surfaces beside a step tell whether it is broken, or a place taken for another one.

Of a short drive loops show a broken step at one place alone, before it or behind. A place that is taken for another one
looks like that, too; but there the surfaces agree where odometry has them. Only where these contradict the poses
without the mending, and none the poses with it, the step is broken (docs/decisions/0363).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.merge.evidence import MergeEvidence, MergeLimits, MergeRefusal, surfaces_refusal
from revisit.core.pose_graph.faults import OdometryFault, doubt
from revisit.core.pose_graph.graph import GraphState
from revisit.service.features.graph.reading import MapTask
from revisit.service.ports.map_optimiser import OptimisedMap, SessionTrack

Placed = Mapping[int, Matrix4]
"""T_map_submap (4, 4) of submaps by number."""

Comparison = Callable[[Placed, Placed], MergeEvidence | None]
"""The surfaces of two groups of submaps, None where they cannot be read."""

DRIFT_DEG, DRIFT_M = (-2.0, -1.0, 1.0, 2.0), (-0.7, 0.7)
"""Turns about the vertical and shifts aside, from which surfaces of a stretch look wrong that is but poorly held."""

BENT = 7
"""Submaps before and behind a broken step that are bent for it where the loops of both sides are in the map."""

FAR = 20
"""Submaps before and behind it that lie elsewhere where the loops of one side alone are in the map."""

COVERED = 2
"""Submaps that cover a step, before and behind it: their own clouds are torn by it."""

_AGAINST = frozenset({MergeRefusal.SURFACES_DISAGREE, MergeRefusal.FREE_SPACE_VIOLATED})


def decided(task: MapTask, optimised: OptimisedMap, compared: Comparison, limits: MergeLimits) -> OptimisedMap:
    """The solution with its undecided faults mended, or without them, where the surfaces decide; else as it is."""
    other = optimised.otherwise
    if other is None:
        return optimised
    sides = [side for fault in optimised.faults if fault.undecided for side in _sides(task, other, fault)]
    as_it_is, mended = (_Surfaces(_poses(task, one), compared, limits) for one in (optimised, other))
    if all(mended.agree(side) for side in sides):
        if any(as_it_is.contradict(side) for side in sides):
            return replace(other, faults=tuple(replace(one, undecided=False) for one in optimised.faults))
    elif all(as_it_is.agree(side) for side in sides):
        return _without_doubt(optimised, other)
    return optimised


def _without_doubt(optimised: OptimisedMap, other: OptimisedMap) -> OptimisedMap:
    """The solution without undecided faults, as sure as it is without these."""
    tracks = [
        replace(one, covariances=one.covariances - doubt(one.T_map_submap, its.T_map_submap))
        if one.anchor == its.anchor
        else one
        for one, its in zip(optimised.tracks, other.tracks, strict=True)
    ]
    faults = tuple(one for one in optimised.faults if not one.undecided)
    return replace(optimised, tracks=tuple(tracks), faults=faults, otherwise=None)


@dataclass(frozen=True)
class _Side:
    """Submaps of a session beside a fault, the nearest one first, and those of the drives that loops join them with."""

    submaps: tuple[int, ...]
    beside: frozenset[int]


def _sides(task: MapTask, other: OptimisedMap, fault: OdometryFault) -> Iterator[_Side]:
    """Stretches before the fault and behind it, short ones and long ones."""
    track = next(one for one in task.graph.tracks if str(one.session_number) == fault.session)
    until, start = fault.first + 1, fault.last
    own = frozenset(track.submaps[max(0, until - FAR) : start + FAR])
    beside = frozenset(number for one in task.graph.tracks for number in _passed(one, _joined(task, other, own))) - own
    for reach in (BENT, FAR):
        before = track.submaps[max(0, until - reach) : max(0, until - COVERED)]
        yield _Side(before[::-1], beside)
        yield _Side(track.submaps[start + COVERED : start + reach], beside)


def _joined(task: MapTask, other: OptimisedMap, own: frozenset[int]) -> frozenset[int]:
    """The submaps that loops join with those of a stretch, where the fault is mended."""
    holds = {loop.number for loop in other.loops if loop.state is GraphState.IN_MAP}
    ends = [frozenset((loop.match, loop.query)) for loop in task.graph.loops if loop.number in holds]
    return frozenset[int]().union(*(pair for pair in ends if len(pair & own) == 1)) - own


def _passed(track: SessionTrack, joined: frozenset[int]) -> Sequence[int]:
    """The submaps of a drive from the first to the last of those `joined`."""
    places = [place for place, number in enumerate(track.submaps) if number in joined]
    return track.submaps[places[0] : places[-1] + 1] if places else ()


def _poses(task: MapTask, optimised: OptimisedMap) -> dict[int, Matrix4]:
    """T_map_submap (4, 4) of all submaps by number."""
    tracks = zip(task.graph.tracks, optimised.tracks, strict=True)
    return {
        number: np.asarray(pose)
        for track, solved in tracks
        for number, pose in zip(track.submaps, solved.T_map_submap, strict=True)
    }


@dataclass(frozen=True)
class _Surfaces:
    """Surfaces of submaps at `poses`."""

    poses: dict[int, Matrix4]
    compared: Comparison
    limits: MergeLimits

    def agree(self, side: _Side) -> bool:
        """Whether they do on one side of a fault."""
        return self._refusal(side, np.eye(4)) is None

    def contradict(self, side: _Side) -> bool:
        """Whether they do so however the side has drifted from the fault on."""
        return bool(side.submaps) and all(self._refusal(side, drift) in _AGAINST for drift in _drifts())

    def _refusal(self, side: _Side, drift: Matrix4) -> MergeRefusal | None:
        if not side.submaps or not side.beside:
            return MergeRefusal.OVERLAP_TOO_SMALL
        nearest = self.poses[side.submaps[0]]
        moved = nearest @ drift @ se3.inverse(nearest)
        first = {number: np.asarray(moved @ self.poses[number]) for number in side.submaps}
        evidence = self.compared(first, {number: self.poses[number] for number in sorted(side.beside)})
        return MergeRefusal.OVERLAP_TOO_SMALL if evidence is None else surfaces_refusal(evidence, self.limits)


def _drifts() -> Iterator[Matrix4]:
    """Ways in which odometry may have drifted over a stretch: none first."""
    for turn_deg in (0.0, *DRIFT_DEG):
        for aside_m in (0.0, *DRIFT_M):
            yield se3.from_yaw(np.radians(turn_deg), (0.0, aside_m, 0.0))
