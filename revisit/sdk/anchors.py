"""Anchors as a client makes them: places on earth, or in metres from the origin of a map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from revisit.core.errors import BadField
from revisit.sdk.messages import pose_message

ANCHORS_AT_ONCE = 200
"""Of one call."""


@dataclass(frozen=True)
class NewAnchor:
    """The measured place of a point of the robot at `stamp_ns`.

    One of both: `geodetic`, latitude and longitude in degrees and altitude above the ellipsoid in metres (WGS 84), or
    `local_m`, metres east, north and above the origin of the map. covariance_enu (3, 3), m^2, or three standard
    deviations, metres. `offset_m` is the point in the frame of the sensor. T_odom_sensor (4, 4) may be left out where
    the scans before and after are stored. kind: GNSS, CONTROL_POINT or KNOWN_POSE; the last one needs `heading_rad` of
    the sensor's x axis, counter-clockwise from east, and its standard deviation.
    """

    anchor_id: str
    kind: str
    stamp_ns: int
    covariance_enu: Any
    geodetic: tuple[float, float, float] | None = None
    local_m: tuple[float, float, float] | None = None
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    T_odom_sensor: Any = None
    heading_rad: float | None = None
    heading_sigma_rad: float | None = None

    def message(self) -> dict[str, Any]:
        """The fields of a NewAnchor of the interface. Raises BadField for standard deviations that are not positive."""
        stated = np.asarray(self.covariance_enu, dtype=np.float64)
        if stated.shape == (3,) and not (stated > 0.0).all():
            raise BadField("standard deviations must be positive", field="covariance_enu")
        covariance = np.diag(stated**2) if stated.shape == (3,) else stated
        earth = ("latitude_deg", "longitude_deg", "altitude_m")
        fields = {
            "anchor_id": self.anchor_id,
            "kind": self.kind,
            "stamp_ns": self.stamp_ns,
            "covariance_enu": covariance.ravel().tolist(),
            "geodetic": None if self.geodetic is None else dict(zip(earth, map(float, self.geodetic), strict=True)),
            "local_m": None if self.local_m is None else dict(zip("xyz", map(float, self.local_m), strict=True)),
            "offset_m": dict(zip("xyz", map(float, self.offset_m), strict=True)),
            "t_odom_sensor": pose_message(self.T_odom_sensor, "T_odom_sensor"),
            "heading_rad": self.heading_rad,
            "heading_sigma_rad": self.heading_sigma_rad,
        }
        return {name: value for name, value in fields.items() if value is not None}
