"""Independent support for a loop that geometry alone cannot tell from its rivals (docs/decisions/0161).

Where a place repeats, each loop along it has the same hypotheses, one period apart, and every one of them has as much
support along the drive as the true one. A loop beside it that is sure of itself breaks the tie: the end of a
row. Odometry of both drives carries its pose over, and its error grows by far less than a period on the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3


@dataclass(frozen=True)
class NeighbourLoop:
    """A loop between the same two drives, beside an ambiguous one.

    poses: its hypotheses, each carried over by odometry to a T_match_query (4, 4) of the ambiguous pair.
    accepted: and not for the sake of other loops. query_m and match_m: how far from the ends of the pair its own ends
    lie, metres ahead along either drive; way_m: the way of both drives together over which odometry carries its poses.
    """

    accepted: bool
    poses: tuple[se3.Matrix4, ...]
    query_m: float
    match_m: float
    way_m: float

    def with_first(self) -> NeighbourLoop:
        """With its best hypothesis alone."""
        return replace(self, poses=self.poses[:1])


@dataclass(frozen=True)
class NeighbourSupport:
    """Which hypothesis of an ambiguous loop the loops beside it agree with.

    hypothesis: its row in those that were given; anchors: submaps of the query's drive whose accepted loops agree;
    agreeing: all loops that do; along_m: over how many metres of both drives.
    """

    hypothesis: int
    anchors: int
    agreeing: int
    along_m: float


@dataclass(frozen=True)
class PredictedPose:
    """T_match_query (4, 4) of a pair as the loops beside it tell it; `agreeing`: how many of them tell the same."""

    T_match_query: se3.Matrix4
    agreeing: int


def find_support(
    hypotheses: Sequence[se3.Matrix4], neighbours: Sequence[NeighbourLoop], config: VerificationConfig
) -> NeighbourSupport | None:
    """The one of `hypotheses` (each T_match_query) that the `neighbours` single out, or None where none is.

    Accepted neighbours of at least `support_anchors` submaps must agree with it, and no accepted one may contradict it;
    together with the pair, all that agree must reach along `support_length` metres of both drives, and half of all
    neighbours must be among them. A neighbour counts only where odometry carries it so well that, where it agrees, it
    cannot agree with another hypothesis: an endless row never has such support, because none of its loops is accepted.
    """
    near = _within_reach(neighbours, config)
    for row, T_match_query in enumerate(hypotheses):
        others = [*hypotheses[:row], *hypotheses[row + 1 :]]
        telling = [one for one in near if tells_apart(T_match_query, others, one, config)]
        anchors = len({one.query_m for one in telling if one.accepted})
        contradicted = any(one.accepted and not agrees(T_match_query, one, config) for one in near)
        if anchors < config.support_anchors or contradicted:
            continue
        agreeing = [one for one in telling if agrees(T_match_query, one, config)]
        along_m = min(_reach([one.query_m for one in agreeing]), _reach([one.match_m for one in agreeing]))
        if along_m >= config.support_length and 2 * len(agreeing) >= len(telling):
            return NeighbourSupport(row, anchors, len(agreeing), along_m)
    return None


def predicted_pose(neighbours: Sequence[NeighbourLoop], config: VerificationConfig) -> PredictedPose | None:
    """The first pose of the neighbour with the shortest way, of those within `support_reach`; None where there is none.

    How many agree with it, itself among them, is its weight: a guess, or known (docs/decisions/0161).
    """
    near = [one for one in _within_reach(neighbours, config) if one.accepted]
    if not near:
        return None
    T_match_query = min(near, key=lambda one: one.way_m).poses[0]
    return PredictedPose(T_match_query, sum(agrees(T_match_query, one, config) for one in near))


def _within_reach(neighbours: Sequence[NeighbourLoop], config: VerificationConfig) -> list[NeighbourLoop]:
    """Those that odometry can speak of: no more than `support_reach` of way along both drives."""
    return [one for one in neighbours if one.way_m <= config.support_reach]


def tells_apart(
    hypothesis: se3.Matrix4, others: Sequence[se3.Matrix4], neighbour: NeighbourLoop, config: VerificationConfig
) -> bool:
    """Whether no pose can agree with a hypothesis and one of the others after odometry has carried it."""
    tolerance_m, tolerance_rad = _tolerance(neighbour, config)
    return all(
        _shift(hypothesis, other) > 2.0 * tolerance_m or _turn(hypothesis, other) > 2.0 * tolerance_rad
        for other in others
    )


def agrees(T_match_query: se3.Matrix4, neighbour: NeighbourLoop, config: VerificationConfig) -> bool:
    """Whether a pose is one of the neighbour's hypotheses, as near as odometry can tell."""
    tolerance_m, tolerance_rad = _tolerance(neighbour, config)
    return any(
        _shift(T_match_query, pose) < tolerance_m and _turn(T_match_query, pose) < tolerance_rad
        for pose in neighbour.poses
    )


def _tolerance(neighbour: NeighbourLoop, config: VerificationConfig) -> tuple[float, float]:
    """Tolerance of a carried pose, metres and radians: its own error, and drift along the way."""
    return config.support_tolerance + config.support_drift * neighbour.way_m, np.radians(config.support_turn)


def _shift(one: se3.Matrix4, other: se3.Matrix4) -> float:
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3]))


def _turn(one: se3.Matrix4, other: se3.Matrix4) -> float:
    return float(se3.rotation_angle(se3.inverse(one) @ other))


def _reach(ahead_m: Sequence[float]) -> float:
    """How long a piece of a drive the pair, at 0, and its neighbours `ahead_m` lie on."""
    return max([0.0, *ahead_m]) - min([0.0, *ahead_m])
