"""A fix of satellites as ROS has it: whether it tells a place, and how well, the same for bags and for live robots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ASSUMED_SIGMAS_M = {0: (3.0, 3.0, 6.0), 1: (1.5, 1.5, 3.0), 2: (0.5, 0.5, 1.0)}
"""East, north and up, by the status of a fix whose covariance nobody tells."""

LEAST_VARIANCE_M2, MOST_VARIANCE_M2 = 1e-4, 1e6


@dataclass(frozen=True)
class SatelliteFix:
    """A sensor_msgs/NavSatFix: latitude and longitude, degrees, and altitude above the ellipsoid, metres (WGS 84).

    covariance (3, 3) of east, north and up, m^2, None where the receiver does not tell it. `status`: -1 is no fix, 0 a
    fix, 1 with corrections of satellites, 2 with those of stations on the ground.
    """

    stamp_ns: int
    frame: str
    status: int
    position: tuple[float, float, float]
    covariance: NDArray[np.float64] | None

    @property
    def is_place(self) -> bool:
        """Whether it tells a place: the receiver has a fix, and its numbers are degrees, not zeros before the first."""
        latitude, longitude, _ = self.position
        finite = bool(np.isfinite(self.position).all())
        return self.status >= 0 and finite and (latitude, longitude) != (0.0, 0.0) and self._on_earth()

    def _on_earth(self) -> bool:
        return abs(self.position[0]) <= 90.0 and abs(self.position[1]) <= 180.0

    def covariance_enu(self) -> NDArray[np.float64]:
        """The covariance (3, 3) told, within bounds, m^2; else an assumed one."""
        told = self.covariance
        if told is None or not np.isfinite(told).all() or not (np.diag(told) > 0.0).all():
            return np.diag(np.square(ASSUMED_SIGMAS_M.get(self.status, ASSUMED_SIGMAS_M[0])))
        variances, axes = np.linalg.eigh(0.5 * (told + told.T))
        return np.asarray((axes * np.clip(variances, LEAST_VARIANCE_M2, MOST_VARIANCE_M2)) @ axes.T)
