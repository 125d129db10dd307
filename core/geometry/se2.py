"""Rigid motions in the horizontal plane: a yaw in radians, then a translation in metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3

Array64 = NDArray[np.float64]


@dataclass(frozen=True)
class PlanarPose:
    """A pose in the plane, T_target_source: turn by `yaw` radians about z, then move by `translation` (2,) metres."""

    yaw: float
    translation: Array64

    def apply(self, points: Array64) -> Array64:
        """The (n, 2) `points` of the source frame in the target frame."""
        return turned(points, self.yaw) + self.translation

    def lifted(self, height: float = 0.0) -> se3.Matrix4:
        """The same motion in space (4, 4), followed by a rise of `height` metres."""
        return se3.from_yaw(self.yaw, (*self.translation, height))


def turned(points: Array64, yaw: float) -> Array64:
    """The (n, 2) `points` turned by `yaw` radians about the origin, counterclockwise."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.asarray(points @ np.array([[cosine, sine], [-sine, cosine]]))


def angle_between(one: Array64, other: float) -> Array64:
    """The absolute difference (n,) of angles in radians, in [0, pi]."""
    return np.abs((one - other + np.pi) % (2.0 * np.pi) - np.pi)


def least_squares_pose(source: Array64, target: Array64) -> PlanarPose:
    """The pose that maps `source` (n, 2) to `target` (n, 2) with the smallest squared error; n at least 1."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    yaw = float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))
    return PlanarPose(yaw, target.mean(axis=0) - turned(source.mean(axis=0)[None], yaw)[0])
