"""Keypoints of two places that look alike, and which of them agree with a planar pose (paper III-E, end)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import VerificationConfig
from revisit.core.geometry.se2 import PlanarPose, angle_between
from revisit.core.place import Place

Array64 = NDArray[np.float64]


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

    def agreeing(self, pose: PlanarPose, config: VerificationConfig) -> NDArray[np.bool_]:
        """Which pairs (p,) the pose T_match_query brings together, with about the turn that they imply."""
        gaps = np.linalg.norm(pose.apply(self.query_points) - self.match_points, axis=1)
        turned = angle_between(self.yaws, pose.yaw) < np.radians(config.yaw_tolerance)
        return np.asarray((gaps < config.keypoint_tolerance) & turned)


def correspond(query: Place, match: Place, limit: int) -> Correspondences:
    """For each keypoint of either place, the one of the other that looks most alike; at most `limit` pairs.

    A patch may look alike directly or turned by 180 degrees. The better of the two decides about the yaw.
    """
    kept, changed = (
        query.descriptors[:, side] @ match.descriptors[:, side].T for side in (query.parity > 0, query.parity <= 0)
    )
    likeness = kept + np.abs(changed)  # the larger one of kept + changed (direct) and kept - changed (turned)
    pairs = _mutual_best(likeness)
    pairs = pairs[np.argsort(-likeness[pairs[:, 0], pairs[:, 1]], kind="stable")][:limit]
    rows, columns = pairs[:, 0], pairs[:, 1]
    yaws = match.orientations[columns].astype(np.float64) - query.orientations[rows]
    yaws = yaws + np.pi * (changed[rows, columns] < 0)
    points = query.keypoints[rows].astype(np.float64), match.keypoints[columns].astype(np.float64)
    return Correspondences(pairs, *points, yaws)


def _mutual_best(likeness: NDArray[np.floating]) -> NDArray[np.int64]:
    """The distinct pairs (p, 2) of each row with its best column and of each column with its best row."""
    if likeness.size == 0:
        return np.zeros((0, 2), np.int64)
    rows, columns = likeness.shape
    forward = np.arange(rows) * columns + likeness.argmax(axis=1)
    backward = likeness.argmax(axis=0) * columns + np.arange(columns)
    return np.stack(np.divmod(np.unique(np.concatenate([forward, backward])), columns), axis=1)
