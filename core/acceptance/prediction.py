"""Predicted poses: the accepted pairs of a query say where its further candidates lie, and which need no comparison.

Candidates of one query belong together: odometry says how those of one drive lie to each other, and the map how those
of several drives do. Once one is a loop, the pose of the others is a guess; once `enough` agree on it, another loop
there would tell the map nothing new (docs/decisions/0161).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from revisit.core.acceptance.claim import Station, StationInMap
from revisit.core.acceptance.drive_loops import least_way_m
from revisit.core.acceptance.neighbour_support import NeighbourLoop, predicted_pose
from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.pair_verdict import Authority, InitialPose, PairVerdict, VerifiedLoop

_WINDOWS = 3.0
"""Windows between two submaps up to which they share about half of what they have seen. Repetition within that is
seen as a rival of each single loop (docs/decisions/0080); repetition farther away, by farther candidates.
"""


@dataclass(frozen=True)
class PredictedPose:
    """How a candidate lies to the query, as accepted pairs predict it.

    within_reach: the two lie within `_WINDOWS`; is_known: and enough pairs agree on it.
    """

    T_match_query: Matrix4
    within_reach: bool
    is_known: bool

    @property
    def hint(self) -> InitialPose | None:
        """Where registration may start; None where the two are too far apart to share much."""
        return InitialPose(self.T_match_query, Authority.HINT) if self.within_reach else None


@dataclass(frozen=True)
class _Stands:
    """Where an accepted pair puts the query: in the odometry frame of the matched drive, and in a frame of the map."""

    match: Station
    T_odom_query: Matrix4
    frame: str | None
    T_map_query: Matrix4 | None


class PredictedPoses:
    """The accepted pairs of one query, in the order in which they were found, and the poses that they predict."""

    def __init__(
        self,
        candidates: Sequence[Station],
        config: PipelineConfig,
        in_map: Callable[[], Sequence[StationInMap | None]] | None = None,
    ) -> None:
        """`in_map`: where the candidates lie in the map; asked once, when the first pair has been accepted."""
        self._candidates, self._config, self._ask_map = candidates, config, in_map
        self._stands: list[_Stands] = []

    @cached_property
    def _in_map(self) -> Sequence[StationInMap | None]:
        return [None] * len(self._candidates) if self._ask_map is None else self._ask_map()

    def add(self, row: int, verdict: PairVerdict) -> None:
        """Take in the verdict on the candidate in a row; only an accepted pair predicts anything."""
        if not isinstance(verdict, VerifiedLoop):
            return
        match, in_map, T_match_query = self._candidates[row], self._in_map[row], verdict.measurement.T_match_query
        T_map_query = None if in_map is None else in_map.T_map_submap @ T_match_query
        frame = None if in_map is None else in_map.frame
        self._stands.append(_Stands(match, match.T_odom_submap @ T_match_query, frame, T_map_query))

    def of(self, row: int) -> PredictedPose | None:
        """The pose that the pairs so far predict of the candidate in a row; None where they predict none."""
        found = predicted_pose([*self._by_odometry(row), *self._by_map(row)], self._config.verification)
        if found is None:
            return None
        # Far candidates are always compared: a second place that looks alike must not be hidden.
        within_reach = float(np.linalg.norm(found.T_match_query[:3, 3])) <= _WINDOWS * self._config.submap.tau
        is_known = within_reach and 0 < self._config.loop.enough <= found.agreeing
        return PredictedPose(found.T_match_query, within_reach, is_known)

    def _by_odometry(self, row: int) -> list[NeighbourLoop]:
        """Predictions of pairs with the same drive, carried by odometry."""
        match, stride_m = self._candidates[row], self._config.submap.stride
        T_match_odom = se3.inverse(match.T_odom_submap)
        return [
            _said(T_match_odom @ one.T_odom_query, _way_between(match, one.match, stride_m))
            for one in self._stands
            if self._is_carried(match, one)
        ]

    def _by_map(self, row: int) -> list[NeighbourLoop]:
        """Predictions of the other pairs by the map: as good as odometry on its longest way."""
        in_map = self._in_map[row] if self._stands else None
        if in_map is None:
            return []
        match, T_match_map = self._candidates[row], se3.inverse(in_map.T_map_submap)
        return [
            _said(T_match_map @ one.T_map_query, self._config.verification.support_reach)
            for one in self._stands
            if one.T_map_query is not None and one.frame == in_map.frame and not self._is_carried(match, one)
        ]

    def _is_carried(self, match: Station, stands: _Stands) -> bool:
        stride_m, reach_m = self._config.submap.stride, self._config.verification.support_reach
        return match.drive == stands.match.drive and _way_between(match, stands.match, stride_m) <= reach_m


def verify_in_turn(
    predicted: PredictedPoses, count: int, verify: Callable[[int, InitialPose | None], PairVerdict]
) -> dict[int, PairVerdict]:
    """The verdicts on `count` candidates, most similar first, by row; without those whose pose is known by then.

    verify(row, initial) verifies one, with the predicted pose as a hint where there is one.
    """
    verdicts = dict[int, PairVerdict]()
    for row in range(count):
        pose = predicted.of(row)
        if pose is None or not pose.is_known:
            verdicts[row] = verify(row, pose.hint if pose is not None else None)
            predicted.add(row, verdicts[row])
    return verdicts


def _way_between(submap: Station, other: Station, stride_m: float) -> float:
    apart_m = float(np.linalg.norm(submap.T_odom_submap[:3, 3] - other.T_odom_submap[:3, 3]))
    return float(least_way_m(apart_m, other.ordinal - submap.ordinal, stride_m))


def _said(T_match_query: Matrix4, way_m: float) -> NeighbourLoop:
    """An accepted pair of the query itself, as a predictor of another candidate."""
    return NeighbourLoop(True, (T_match_query,), 0.0, way_m, way_m)
