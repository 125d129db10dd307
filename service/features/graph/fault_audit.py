"""Undecided faults of odometry: the surfaces beside a step tell whether it is broken, or a place taken for another one.

Of a short drive loops show a broken step at one place alone, before it or behind. A place that is taken for another one
looks like that, too; but there the surfaces agree where odometry carries them across the step. Only where these
contradict each other on either side, and agree where the step is mended, it is broken (docs/decisions/0363).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.merge.evidence import MergeEvidence, MergeLimits, MergeRefusal, surfaces_refusal
from revisit.core.pose_graph.faults import OdometryFault, doubt
from revisit.core.pose_graph.graph import GraphState
from revisit.service.features.graph.reading import MapTask
from revisit.service.ports.map_optimiser import OptimisedMap, SessionTrack

Placed = Mapping[int, Matrix4]
"""T_map_submap (4, 4) of submaps by number."""

Odometry = Mapping[int, NDArray[np.float64]]
"""T_odom_submap (n, 4, 4) of sessions by number."""

Comparison = Callable[[Placed, Placed], MergeEvidence | None]
"""The surfaces of two groups of submaps, None where they cannot be read."""

DRIFT_DEG, DRIFT_M = (-2.0, -1.0, 1.0, 2.0), (-0.7, 0.7)
"""Turns about the vertical and shifts aside, from which surfaces of a stretch look wrong that is but poorly held."""

NEAR = 7
"""Submaps before and behind it that odometry has hardly moved elsewhere."""

FAR = 20
"""Submaps before and behind it that are looked at, at most."""

COVERED = 2
"""Submaps that cover a step, before and behind it: their own clouds are torn by it."""

_AGAINST = frozenset({MergeRefusal.SURFACES_DISAGREE, MergeRefusal.FREE_SPACE_VIOLATED})


def decided(task: MapTask, optimised: OptimisedMap, compared: Comparison, limits: MergeLimits) -> OptimisedMap:
    """The solution with its undecided faults mended, or without them, where the surfaces decide; else as it is."""
    other = optimised.otherwise
    if other is None:
        return optimised
    poses, odometry = _poses(task, other), (optimised.T_odom_submap, other.T_odom_submap)
    stretch = partial(_Stretch, compared=compared, limits=limits)
    faults = [_sides(task, other, poses, odometry, fault, stretch) for fault in optimised.faults if fault.undecided]
    sides = [side for fault in faults for stretches in fault for side in stretches]
    if all(side.mended.agrees() for side in sides):
        stretches = [some for fault in faults for some in fault]
        is_broken = all(any(one.by_odometry.contradicts() for one in some) for some in stretches)
        faults_now = tuple(replace(one, undecided=False) for one in optimised.faults)
        return replace(other, faults=faults_now) if is_broken else optimised
    if any(side.mended.contradicts() for side in sides):
        stands = [[all(one.by_odometry.agrees() for one in some) for some in fault] for fault in faults]
        is_right = all(any(either) for either in stands)
        return _without_doubt(optimised, other) if is_right else optimised
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
    """Submaps of a session beside a fault: where it is mended, and where odometry, which is without other faults,
    carries them across it, as if the loops of this side were wrong. They lie beside those that loops join them with.
    """

    mended: _Stretch
    by_odometry: _Stretch


def _sides(
    task: MapTask, other: OptimisedMap, poses: dict[int, Matrix4], odometry: tuple[Odometry, Odometry],
    fault: OdometryFault, stretch: Callable[[Placed, Placed], _Stretch],
) -> tuple[list[_Side], list[_Side]]:  # fmt: skip
    """Short and long stretches before a fault, and such behind it; `poses` of all submaps where it is mended.

    `odometry`: without the mending of undecided faults, and with it.
    """
    track = next(one for one in task.graph.tracks if str(one.session_number) == fault.session)
    stated, mended = (one[track.session_number] for one in odometry)
    until, start = fault.first + 1, fault.last
    own = frozenset(track.submaps[max(0, until - FAR) : start + FAR])
    joined = _joined(task, other, own)
    beside = {n: poses[n] for one in task.graph.tracks for n in _passed(one, joined) if n not in own}

    def side(ordinals: Sequence[int], across: int, near: int) -> _Side:
        T_map_near = poses[track.submaps[across]] @ se3.inverse(stated[across]) @ stated[near]
        T_map_odom = T_map_near @ se3.inverse(mended[near])
        carried = {track.submaps[k]: np.asarray(T_map_odom @ mended[k]) for k in ordinals}
        return _Side(stretch({number: poses[number] for number in carried}, beside), stretch(carried, beside))

    last, count = max(0, until - COVERED) - 1, len(track.submaps)
    before = [side(range(last, max(0, until - reach) - 1, -1), start, fault.first) for reach in (NEAR, FAR)]
    behind = [side(range(start + COVERED, min(start + reach, count)), fault.first, start) for reach in (NEAR, FAR)]
    return before, behind


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


class _Stretch:
    """The submaps of a side where they may lie, beside others. Each comparison of their surfaces is made once."""

    def __init__(self, placed: Placed, beside: Placed, compared: Comparison, limits: MergeLimits) -> None:
        """T_map_submap (4, 4) of the submaps, the nearest to the fault first."""
        self._placed = placed
        self._beside = beside
        self._compared = compared
        self._limits = limits
        self._refusals: list[MergeRefusal | None] = []

    def agrees(self) -> bool:
        """Whether surfaces agree, as the side may have drifted."""
        return any(refusal is None for refusal in self._each())

    def contradicts(self) -> bool:
        """Whether they contradict each other however the side has drifted."""
        return all(refusal in _AGAINST for refusal in self._each())

    def _each(self) -> Iterator[MergeRefusal | None]:
        """What surfaces refuse at each drift, as far as it is asked for."""
        for number, drift in enumerate(_drifts()):
            if number == len(self._refusals):
                self._refusals.append(self._refusal(drift))
            yield self._refusals[number]

    def _refusal(self, drift: Matrix4) -> MergeRefusal | None:
        if not self._placed or not self._beside:
            return MergeRefusal.OVERLAP_TOO_SMALL
        nearest = next(iter(self._placed.values()))
        moved = nearest @ drift @ se3.inverse(nearest)
        placed = {number: np.asarray(moved @ pose) for number, pose in self._placed.items()}
        evidence = self._compared(placed, self._beside)
        return MergeRefusal.OVERLAP_TOO_SMALL if evidence is None else surfaces_refusal(evidence, self._limits)


def _drifts() -> Iterator[Matrix4]:
    """Ways in which odometry may have drifted over a stretch: none first."""
    for turn_deg in (0.0, *DRIFT_DEG):
        for aside_m in (0.0, *DRIFT_M):
            yield se3.from_yaw(np.radians(turn_deg), (0.0, aside_m, 0.0))
