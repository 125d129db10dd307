"""Where anchors put one submap of a pair to the other, and which of the poses that fit the pair lies there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.anchored_drive import OWN_ERROR_M, Fix

Array64 = NDArray[np.float64]

SIGMAS = 3.0
"""So many standard deviations of both places a pose may lie off; one that does not is not chosen, and others that could
be must lie twice as far away.
"""

SURE_M = 1.5
"""Anchors must be as sure of heights, because storeys and decks are as like as rows are; and of the place on the ground
where a pair has one pose alone, doubted by others. Places that repeat lie farther apart.
"""

SAME_TURN_RAD = np.radians(15.0)
"""Poses that repeat are turned by a quarter, or not at all."""


@dataclass(frozen=True)
class Between:
    """A query as anchors put it to a match: place (2,) on the ground and rise along the axes of the odometry of the
    match, and R_odom_query (3, 3) there, with R_odom_match (3, 3); and by how much a pose may differ.
    """

    place: Array64
    rise_m: float
    R_odom_match: Array64
    R_odom_query: Array64
    allowed_m: float
    allowed_rise_m: float
    allowed_rad: float

    @classmethod
    def of(cls, match: Fix, query: Fix) -> Between:
        """As places on earth put two submaps."""
        east, north = query.place - match.place
        ahead = complex(east, north) * np.exp(-1j * match.turn_rad)
        sigma_m = float(np.hypot(np.hypot(match.sigma_m, query.sigma_m), match.sigma_rad * abs(ahead)))
        return cls(
            np.array([ahead.real, ahead.imag]),
            query.height_m - match.height_m,
            match.R_odom_submap,
            se3.from_yaw(query.turn_rad - match.turn_rad)[:3, :3] @ query.R_odom_submap,
            OWN_ERROR_M + SIGMAS * sigma_m,
            OWN_ERROR_M + SIGMAS * float(np.hypot(match.sigma_up_m, query.sigma_up_m)),
            SAME_TURN_RAD + SIGMAS * float(np.hypot(match.sigma_rad, query.sigma_rad)),
        )

    def agreeing(self, poses: Sequence[se3.Matrix4]) -> list[int]:
        """The rows of the poses that lie there."""
        return [row for row, off in enumerate(self._offs(poses)) if off <= 1.0]

    def has_beside(self, poses: Sequence[se3.Matrix4]) -> bool:
        """Whether the nearest of the poses lies between half and twice as far off as it may."""
        return 0.5 < min(self._offs(poses), default=np.inf) <= 2.0

    def kept(self, poses: Sequence[se3.Matrix4]) -> int | None:
        """The first row, where its pose lies there."""
        return 0 if 0 in self.agreeing(poses) else None

    def only(self, poses: Sequence[se3.Matrix4]) -> int | None:
        """The row of the one pose that lies there, where no two could: these all lie farther apart than anchors err."""
        rows = self.agreeing(poses)
        if len(rows) != 1 or self.allowed_rise_m > SURE_M:
            return None
        tells_apart = self.allowed_m <= SURE_M if len(poses) == 1 else self._tells_apart(poses)
        return rows[0] if tells_apart else None

    def _offs(self, poses: Sequence[se3.Matrix4]) -> list[float]:
        """How far off each pose lies, as a share of what it may."""
        return [self.off(pose) for pose in poses]

    def off(self, pose: se3.Matrix4) -> float:
        """How far off a pose lies, as a share of what it may."""
        ahead = self.R_odom_match @ pose[:3, 3]
        return max(
            float(np.hypot(*(ahead[:2] - self.place))) / self.allowed_m,
            abs(float(ahead[2]) - self.rise_m) / self.allowed_rise_m,
            float(_turned(self.R_odom_match @ pose[:3, :3] @ self.R_odom_query.T) / self.allowed_rad),
        )

    def _tells_apart(self, poses: Sequence[se3.Matrix4]) -> bool:
        leveled = [(self.R_odom_match @ pose[:3, 3], self.R_odom_match @ pose[:3, :3]) for pose in poses]
        return all(
            np.hypot(*(one[:2] - other[:2])) > 2.0 * self.allowed_m
            or _turned(R_one @ R_other.T) > 2.0 * self.allowed_rad
            for (one, R_one), (other, R_other) in combinations(leveled, 2)
        )


def _turned(R: Array64) -> float:
    """The angle by which a rotation (3, 3) turns about the vertical axis, radians."""
    return abs(float(np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])))
