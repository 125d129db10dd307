"""Keypoints of two places that look alike, and the planar pose that most of them agree with (paper III-E, end)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import VerificationConfig
from revisit.core.geometry.se2 import PlanarPose, angle_between, least_squares_pose
from revisit.core.kernels.two_point_vote import best_two_point_pose
from revisit.core.place import Place

Array64 = NDArray[np.float64]

_REFINEMENTS = 3


@dataclass(frozen=True)
class Correspondences:
    """Pairs of keypoints, the most alike first.

    pairs (p, 2): rows of the keypoints of the query and of the match; query_points and match_points (p, 2) metres, in
    the level frames; yaws (p,) radians, the turn from query to match that each pair implies.
    """

    pairs: NDArray[np.int64]
    query_points: Array64
    match_points: Array64
    yaws: Array64

    def __len__(self) -> int:
        return len(self.pairs)


@dataclass(frozen=True)
class KeypointFit:
    """The planar pose T_match_query, the keypoints that agree with it, and how many correspondences there were."""

    pose: PlanarPose
    inliers: int
    correspondences: int


def correspond(query: Place, match: Place, limit: int) -> Correspondences:
    """For each keypoint of either place, the one of the other that looks most alike; at most `limit` pairs.

    A patch may look alike directly or turned by 180 degrees. The better of the two decides about the yaw.
    """
    direct = query.descriptors @ match.descriptors.T
    turned = (query.descriptors * query.parity) @ match.descriptors.T
    likeness = np.maximum(direct, turned)
    pairs = _mutual_best(likeness)
    pairs = pairs[np.argsort(-likeness[pairs[:, 0], pairs[:, 1]], kind="stable")][:limit]
    rows, columns = pairs[:, 0], pairs[:, 1]
    yaws = match.orientations[columns].astype(np.float64) - query.orientations[rows]
    yaws = yaws + np.pi * (turned > direct)[rows, columns]
    points = query.keypoints[rows].astype(np.float64), match.keypoints[columns].astype(np.float64)
    return Correspondences(pairs, *points, yaws)


def _mutual_best(likeness: NDArray[np.floating]) -> NDArray[np.int64]:
    """The distinct pairs (p, 2) of each row with its best column and of each column with its best row."""
    if likeness.size == 0:
        return np.zeros((0, 2), np.int64)
    forward = np.stack([np.arange(len(likeness)), likeness.argmax(axis=1)], axis=1)
    backward = np.stack([likeness.argmax(axis=0), np.arange(likeness.shape[1])], axis=1)
    return np.unique(np.concatenate([forward, backward]), axis=0)


def fit_planar_pose(correspondences: Correspondences, config: VerificationConfig) -> KeypointFit:
    """The planar pose that most correspondences agree with.

    Every two correspondences propose a pose and all vote, so nothing is random. Least squares on those that agree then
    refine the winner. `inliers` counts distinct keypoints.
    """
    source, target, yaws = correspondences.query_points, correspondences.match_points, correspondences.yaws
    yaw_tolerance = np.radians(config.yaw_tolerance)
    best = best_two_point_pose(source, target, yaws, config.keypoint_tolerance, yaw_tolerance)
    pose = PlanarPose(float(best[0]), best[1:3])
    for _ in range(_REFINEMENTS):
        gaps = np.linalg.norm(pose.apply(source) - target, axis=1)
        agree = (gaps < config.keypoint_tolerance) & (angle_between(yaws, pose.yaw) < yaw_tolerance)
        if agree.sum() < 2:
            return KeypointFit(pose, int(agree.sum()), len(correspondences))
        pose = least_squares_pose(source[agree], target[agree])
    distinct = min(len(np.unique(side)) for side in correspondences.pairs[agree].T)
    return KeypointFit(pose, distinct, len(correspondences))
