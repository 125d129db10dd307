"""The planar pose that most corresponding keypoints of two places agree with (paper III-E, end)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import VerificationConfig
from revisit.core.geometry.se2 import PlanarPose, least_squares_pose
from revisit.core.kernels.planar_refinement import refine_planar_pose
from revisit.core.kernels.two_point_vote import best_two_point_pose
from revisit.core.place.correspondences import Correspondences

_REFINEMENTS = 3


@dataclass(frozen=True)
class KeypointFit:
    """The planar pose T_match_query, the keypoints that agree with it, and how many correspondences there were."""

    pose: PlanarPose
    inliers: int
    correspondences: int


def fit_planar_pose(correspondences: Correspondences, config: VerificationConfig) -> KeypointFit:
    """The planar pose that most correspondences agree with.

    Every two correspondences propose a pose and all vote, so nothing is random. Least squares on those that agree then
    refine the winner. `inliers` counts distinct keypoints.
    """
    yaw_tolerance, agree = np.radians(config.yaw_tolerance), np.zeros(len(correspondences), dtype=np.bool_)
    given = correspondences.query_points, correspondences.match_points, correspondences.yaws
    best = best_two_point_pose(*given, config.keypoint_tolerance, yaw_tolerance)[:3]
    refine_planar_pose(*given, config.keypoint_tolerance, yaw_tolerance, _REFINEMENTS, best, agree)
    return _fit_of(PlanarPose(float(best[0]), best[1:]), agree, correspondences)


def plain_refined(
    pose: PlanarPose, correspondences: Correspondences, config: VerificationConfig
) -> tuple[PlanarPose, NDArray[np.bool_]]:
    """The plain form of the compiled refinement: the pose, and which (n,) agreed with the one before."""
    for _ in range(_REFINEMENTS):
        agree = correspondences.agreeing(pose, config)
        if agree.sum() < 2:
            break
        pose = least_squares_pose(correspondences.query_points[agree], correspondences.match_points[agree])
    return pose, agree


def fit_of_pose(pose: PlanarPose, correspondences: Correspondences, config: VerificationConfig) -> KeypointFit:
    """How well a pose that is known otherwise fits the keypoints."""
    return _fit_of(pose, correspondences.agreeing(pose, config), correspondences)


def _fit_of(pose: PlanarPose, agree: NDArray[np.bool_], correspondences: Correspondences) -> KeypointFit:
    distinct = min(len(set(side)) for side in correspondences.pairs[agree].T.tolist())
    return KeypointFit(pose, distinct, len(correspondences))
