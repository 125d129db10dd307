"""Hypotheses: poses of a robot's odometry in a map, as the views along its way bear them out.

A view bears on every hypothesis at once. The pose that explains most of it keeps its weight; another loses by how much
less of the view it explains, and one of which the map expects more than is seen is refuted. What two views have in
common counts once.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.acceptance import Doubt, LoopClaim, StationInMap
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.pair_verdict import LoopMeasurement, RejectionReason


@dataclass(frozen=True)
class Sighting:
    """A pose T_frame_view (4, 4) of one view that one pair says, and how well it fits.

    covariance (6, 6) about the view, along the axes of the frame; fit: the share 0..1 of the view that it explains;
    accepted: the pair is a loop; passes: it passed by itself, or fits at several poses.
    """

    frame: str
    T_frame_view: Matrix4
    covariance: NDArray[np.float64]
    fit: float
    accepted: bool = False
    passes: bool = False


@dataclass(frozen=True)
class Hypothesis:
    """A pose T_frame_odom (4, 4) of the odometry in a frame of the map, with what has borne it out.

    covariance (6, 6) at the view that bore it out last, about that view along the axes of the frame; log_weight against
    the others and against none; views and accepted: views that agree, and those with an accepted pair; from_m and to_m:
    the first and last of them, metres of travel.
    """

    frame: str
    T_frame_odom: Matrix4
    covariance: NDArray[np.float64]
    log_weight: float
    views: int
    accepted: int
    from_m: float
    to_m: float

    def carried(self, T_odom_view: Matrix4) -> Matrix4:
        """T_frame_view by odometry."""
        return np.asarray(self.T_frame_odom @ T_odom_view)

    def covariance_at(self, travelled_m: float) -> NDArray[np.float64]:
        """Its covariance (6, 6) with the drift of odometry since it was borne out last."""
        way_m = travelled_m - self.to_m
        drift, turn = _ODOMETRY_SHIFT * way_m, _ODOMETRY_TURN * way_m
        return np.asarray(self.covariance + np.diag(np.square([drift, drift, drift, turn, turn, turn])))


def sightings_of(claims: Sequence[LoopClaim], in_map: Sequence[StationInMap]) -> list[Sighting]:
    """What the judged claims of a view say of its pose, where their matches lie `in_map`."""
    said = [list(_said(claim, there)) for claim, there in zip(claims, in_map, strict=True)]
    sure = [one for of_claim in said for one in of_claim if one.accepted]
    return [one for of_claim in said for one in _decided(of_claim, sure)]


def _decided(said: Sequence[Sighting], sure: Sequence[Sighting]) -> Sequence[Sighting]:
    """The poses of one pair; of several that fit, those alone that an accepted pair of the same view says."""
    same = [one for one in said if any(_is_said(one, two) for two in sure)]
    return same or said


def _is_said(one: Sighting, other: Sighting) -> bool:
    return one.frame == other.frame and agree(one.T_frame_view, other.T_frame_view)


def _said(claim: LoopClaim, there: StationInMap) -> Iterable[Sighting]:
    measured = claim.measurement
    if measured is None or claim.reason in _NOT_LOOKED_AT:
        return
    covariance = _about_view(measured, there.T_map_submap)
    poses = [(measured.T_match_query, claim.overlap)]
    if claim.ambiguous and Doubt.BETTER_ALTERNATIVE not in claim.doubts:
        poses += [(rival.T_match_query, rival.overlap) for rival in measured.rivals]
    discount = _SEEN_THROUGH_FIT if claim.reason == RejectionReason.SEEN_THROUGH else 1.0
    for T_match_query, overlap in poses:
        T_frame_view = there.T_map_submap @ T_match_query
        yield Sighting(
            there.frame, T_frame_view, covariance, discount * overlap, claim.accepted, claim.accepted or claim.ambiguous
        )


def _about_view(measured: LoopMeasurement, T_frame_match: Matrix4) -> NDArray[np.float64]:
    """The covariance (6, 6) of a pose about the view itself, along the axes of the frame."""
    axes = T_frame_match[:3, :3]
    T_view_match = np.eye(4)
    T_view_match[:3, :3], T_view_match[:3, 3] = axes, -axes @ measured.T_match_query[:3, 3]
    adjoint = se3.adjoint(T_view_match)
    return np.asarray(adjoint @ np.nan_to_num(measured.covariance, nan=1.0, posinf=1.0) @ adjoint.T)


def agree(one: Matrix4, other: Matrix4, way_m: float = 0.0) -> bool:
    """Whether two poses (4, 4) of one view in a frame are the same, `way_m` of odometry between them."""
    apart = one[:3, 3] - other[:3, 3]
    near = float(apart @ apart) < (SAME_M + _SAME_DRIFT * way_m) ** 2
    # The trace of the turn between them: se3.rotation_angle takes ten times as long, and most poses lie apart.
    return near and float(np.sum(one[:3, :3] * other[:3, :3])) > 1.0 + 2.0 * np.cos(_SAME_TURN)


def borne_out(
    known: Hypothesis, said: Sighting, T_odom_view: Matrix4, travelled_m: float, log_weight: float
) -> Hypothesis:
    """A hypothesis moved to where a view says it; its weight as given."""
    return replace(
        known,
        T_frame_odom=said.T_frame_view @ se3.inverse(T_odom_view),
        covariance=said.covariance,
        log_weight=log_weight,
        views=known.views + 1,
        accepted=known.accepted + said.accepted,
        to_m=travelled_m,
    )


def begun(said: Sighting, T_odom_view: Matrix4, travelled_m: float, log_weight: float) -> Hypothesis:
    """A hypothesis that a view brings up."""
    T_frame_odom = said.T_frame_view @ se3.inverse(T_odom_view)
    return Hypothesis(
        said.frame, T_frame_odom, said.covariance, log_weight, 1, int(said.accepted), travelled_m, travelled_m
    )


SAME_M = 1.0
"""Poses of one view nearer to each other than this are one (as in `acceptance.consistent_share`)."""

_SAME_DRIFT = 0.02
_SAME_TURN = np.radians(8.0)
_ODOMETRY_SHIFT, _ODOMETRY_TURN = 0.01, np.radians(0.05)
_SEEN_THROUGH_FIT = 0.5
_NOT_LOOKED_AT = (RejectionReason.DEGENERATE_PLACE, RejectionReason.PLACE_LOST, RejectionReason.NO_COMMON_REGION)
