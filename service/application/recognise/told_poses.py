"""What the accepted loops of a submap tell of its other candidates: where to start, and which need no comparison.

Candidates of one query belong together: odometry says how those of one drive lie to each other, and the map how those
of several drives do. Once one is a loop, the pose of the others is a guess; once `enough` agree on it, another loop
there would tell the map nothing new (docs/decisions/0205).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from revisit.core.config import PipelineConfig
from revisit.core.drive_loops import least_way_m
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.core.neighbour_support import NeighbourLoop, told_pose
from revisit.service.application.contract.map_frames import MapFrames, MapPose
from revisit.service.application.contract.recogniser import LoopVerdict
from revisit.service.application.contract.records import SubmapRecord
from revisit.service.application.contract.transactions import Transactions, UnitOfWork

_WINDOWS = 3.0
"""Windows between two submaps up to which they share about half of what they have seen. What repeats within that is
seen as a rival of each single loop (docs/decisions/0080); what repeats farther away, by farther candidates.
"""

MapPoses = Mapping[int, MapPose]
"""Where submaps, by number, lie in the map."""


@dataclass(frozen=True)
class Told:
    """How a candidate lies to the query, as other loops tell it.

    within_reach: the two lie within `_WINDOWS`; is_known: and enough loops agree on it.
    """

    T_match_query: Matrix4
    within_reach: bool
    is_known: bool


@dataclass(frozen=True)
class _Stands:
    """Where a loop with `match` puts the query: in the odometry frame of its drive, and in a frame of the map."""

    match: SubmapRecord
    T_odom_query: Matrix4
    frame: str | None
    T_map_query: Matrix4 | None


class ToldPoses:
    """The accepted loops of one query, in the order in which they were found, and what they tell."""

    def __init__(self, config: PipelineConfig, map_poses: Callable[[], MapPoses]) -> None:
        """`map_poses` are those of the query's candidates; asked once, when the first loop has been accepted."""
        self._config = config
        self._ask_map = map_poses
        self._stands: list[_Stands] = []

    @cached_property
    def _map_poses(self) -> MapPoses:
        return self._ask_map()

    def take_in(self, match: SubmapRecord, verdict: LoopVerdict) -> None:
        """What was found of a candidate; only an accepted loop tells anything."""
        T_match_query = verdict.T_match_query
        if not verdict.accepted or T_match_query is None:
            return
        in_map = self._map_poses.get(match.number)
        frame, T_map_query = (None, None) if in_map is None else (in_map.frame, _child(in_map.T_map, T_match_query))
        self._stands.append(_Stands(match, _child(match.T_odom_submap, T_match_query), frame, T_map_query))

    def of(self, match: SubmapRecord) -> Told | None:
        """What the loops so far tell of a candidate; None where they tell nothing."""
        told = told_pose([*self._by_odometry(match), *self._by_map(match)], self._config.verification)
        if told is None:
            return None
        # Far candidates are compared whatever is told: a second place that looks alike must not be hidden.
        within_reach = float(np.linalg.norm(told.T_match_query[:3, 3])) <= _WINDOWS * self._config.submap.tau
        is_known = within_reach and 0 < self._config.loop.enough <= told.agreeing
        return Told(told.T_match_query, within_reach, is_known)

    def _by_odometry(self, match: SubmapRecord) -> list[NeighbourLoop]:
        """What the loops with the same drive say that odometry carries so far."""
        T_match_odom, stride_m = se3.inverse(pose_matrix(match.T_odom_submap)), self._config.submap.stride
        return [
            _said(T_match_odom @ one.T_odom_query, _way_between(match, one.match, stride_m))
            for one in self._stands
            if self._is_carried(match, one)
        ]

    def _by_map(self, match: SubmapRecord) -> list[NeighbourLoop]:
        """What the other loops say by the map: as good as odometry on its longest way."""
        in_map = self._map_poses.get(match.number) if self._stands else None
        if in_map is None:
            return []
        T_match_map = se3.inverse(pose_matrix(in_map.T_map))
        return [
            _said(T_match_map @ one.T_map_query, self._config.verification.support_reach)
            for one in self._stands
            if one.T_map_query is not None and one.frame == in_map.frame and not self._is_carried(match, one)
        ]

    def _is_carried(self, match: SubmapRecord, stands: _Stands) -> bool:
        same_drive = match.session_number == stands.match.session_number
        stride_m, reach_m = self._config.submap.stride, self._config.verification.support_reach
        return same_drive and _way_between(match, stands.match, stride_m) <= reach_m


def _child(parent: Sequence[float], T_parent_child: Matrix4) -> Matrix4:
    return np.asarray(pose_matrix(tuple(parent)) @ T_parent_child)


def _way_between(submap: SubmapRecord, other: SubmapRecord, stride_m: float) -> float:
    apart_m = math.dist(submap.position_m, other.position_m)
    return float(least_way_m(apart_m, other.ordinal - submap.ordinal, stride_m))


def _said(T_match_query: Matrix4, way_m: float) -> NeighbourLoop:
    """An accepted loop of the query itself, by what it says of another candidate."""
    return NeighbourLoop(True, (T_match_query,), 0.0, way_m, way_m)


def poses_in_map(transactions: Transactions, submaps: Sequence[SubmapRecord]) -> MapPoses:
    """Where submaps of one map lie in its version in force, those of them that have a place there."""
    return transactions.read(partial(_in_map, submaps=submaps)).result() if submaps else {}


def _in_map(uow: UnitOfWork, submaps: Sequence[SubmapRecord]) -> MapPoses:
    frames = MapFrames(uow, submaps[0].tenant, submaps[0].map_id)
    poses = {one.number: frames.submap(one) for one in submaps}
    return {number: pose for number, pose in poses.items() if pose is not None}
