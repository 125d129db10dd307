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
    kept, changed = (one @ other.T for one, other in zip(query.kept(_by_parity), match.kept(_by_parity), strict=True))
    likeness = kept + np.abs(changed)  # the larger one of kept + changed (direct) and kept - changed (turned)
    pairs = _mutual_best(likeness)
    pairs = pairs[np.argsort(-likeness.ravel()[pairs], kind="stable")][:limit]
    rows, columns = np.divmod(pairs, likeness.shape[1])
    yaws = match.orientations[columns].astype(np.float64) - query.orientations[rows]
    yaws = yaws + np.pi * (changed[rows, columns] < 0)
    points = query.keypoints[rows].astype(np.float64), match.keypoints[columns].astype(np.float64)
    return Correspondences(np.stack([rows, columns], axis=1), *points, yaws)


def _by_parity(place: Place) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The descriptors in two parts: numbers that half a turn leaves as they are, and those that change their sign."""
    return place.descriptors[:, place.parity > 0], place.descriptors[:, place.parity <= 0]


def _mutual_best(likeness: NDArray[np.floating]) -> NDArray[np.int64]:
    """The distinct pairs (p,) of each row with its best column and of each column with its best row, in order.

    A pair is its place in `likeness` (rows, columns), counted row by row.
    """
    rows, columns = likeness.shape
    chosen = np.zeros(likeness.size, dtype=np.bool_)
    if likeness.size:
        chosen[np.arange(rows) * columns + likeness.argmax(axis=1)] = True
        chosen[likeness.argmax(axis=0) * columns + np.arange(columns)] = True
    return np.flatnonzero(chosen)
