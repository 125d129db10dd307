"""Anchors as a client makes them: places on earth, or in metres from the origin of a map, and tags of unknown place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.formats.satellite_fix import SatelliteFix
from revisit.sdk.messages import pose_message
from revisit.sdk.scan_choice import pose_matrix

if TYPE_CHECKING:
    from typing import Self

ANCHORS_AT_ONCE = 200
"""Of one call."""

FIX_STEP_M = 1.0
"""Of the drive between two fixes: a robot that stands still learns nothing more of where it is."""

_EARTH = ("latitude_deg", "longitude_deg", "altitude_m")


@dataclass(frozen=True)
class NewAnchor:
    """The measured place of a point of the robot at `stamp_ns`.

    One of both: `geodetic`, latitude and longitude in degrees and altitude above the ellipsoid in metres (WGS 84), or
    `local_m`, metres east, north and above the origin of the map. covariance_enu (3, 3), m^2, or three standard
    deviations, metres. `offset_m` is the point in the frame of the sensor. T_odom_sensor (4, 4) may be left out where
    the scans before and after are stored. kind: GNSS, CONTROL_POINT, KNOWN_POSE or FIDUCIAL. A KNOWN_POSE needs
    `heading_rad` of the sensor's x axis, counter-clockwise from east, and its standard deviation. A FIDUCIAL is a tag
    of unknown place, seen at `offset_m`: it needs its `tag` and has no place; covariance_enu is along the sensor's
    axes.
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
    tag: str | None = None

    @classmethod
    def of_fix(cls, fix: SatelliteFix, T_odom_sensor: se3.Matrix4, antenna_m: tuple[float, float, float]) -> Self:
        """A fix of satellites; `antenna_m` is the antenna in the frame of the sensor."""
        return cls(
            f"gnss-{fix.stamp_ns}",
            "GNSS",
            fix.stamp_ns,
            fix.covariance_enu(),
            geodetic=fix.position,
            offset_m=antenna_m,
            T_odom_sensor=T_odom_sensor,
        )

    @classmethod
    def of_json(cls, row: Mapping[str, Any]) -> Self:
        """As a request has it, or as the service answers. Raises KeyError where a field is missing; TypeError,
        ValueError, RevisitError for one that cannot be.
        """
        pose, matrix = row.get("t_odom_sensor"), row.get("T_odom_sensor")
        geodetic, local = row.get("geodetic"), row.get("local_m")
        heading, sigma = row.get("heading_rad"), row.get("heading_sigma_rad")
        return cls(
            str(row["anchor_id"] if "anchor_id" in row else row["name"].rpartition("/")[2]),
            str(row["kind"]),
            int(row["stamp_ns"]),
            np.reshape(np.array(row["covariance_enu"], dtype=np.float64), (3, 3)),
            geodetic=None if geodetic is None else _three([geodetic[name] for name in _EARTH]),
            local_m=None if local is None else _three(local),
            offset_m=_three(row.get("offset_m") or (0.0, 0.0, 0.0)),
            T_odom_sensor=pose_matrix(pose) if pose is not None else None if matrix is None else se3.validated(matrix),
            heading_rad=None if heading is None else float(heading),
            heading_sigma_rad=None if sigma is None else float(sigma),
            tag=row.get("tag"),
        )

    def message(self) -> dict[str, Any]:
        """The fields of a NewAnchor of the interface. Raises BadField for standard deviations that are not positive."""
        stated = np.asarray(self.covariance_enu, dtype=np.float64)
        if stated.shape == (3,) and not (stated > 0.0).all():
            raise BadField("standard deviations must be positive", field="covariance_enu")
        covariance = np.diag(stated**2) if stated.shape == (3,) else stated
        fields = {
            "anchor_id": self.anchor_id,
            "kind": self.kind,
            "stamp_ns": self.stamp_ns,
            "covariance_enu": covariance.ravel().tolist(),
            "geodetic": None if self.geodetic is None else dict(zip(_EARTH, map(float, self.geodetic), strict=True)),
            "local_m": None if self.local_m is None else dict(zip("xyz", map(float, self.local_m), strict=True)),
            "offset_m": dict(zip("xyz", map(float, self.offset_m), strict=True)),
            "t_odom_sensor": pose_message(self.T_odom_sensor, "T_odom_sensor"),
            "heading_rad": self.heading_rad,
            "heading_sigma_rad": self.heading_sigma_rad,
            "tag": self.tag,
        }
        return {name: value for name, value in fields.items() if value is not None}


@dataclass
class FixSpacing:
    """Chooses the fixes of a drive that lie `FIX_STEP_M` and more behind the one before."""

    _last: NDArray[np.float64] | None = None

    def takes(self, T_odom_sensor: se3.Matrix4) -> bool:
        """Whether the next fix, at this pose, is one of them."""
        here = np.array(T_odom_sensor[:3, 3], dtype=np.float64)
        if self._last is not None and np.linalg.norm(here - self._last) < FIX_STEP_M:
            return False
        self._last = here
        return True


def _three(told: Mapping[str, Any] | Sequence[Any]) -> tuple[float, float, float]:
    """Three numbers of an object with x, y and z, of which protobuf leaves out the zeros, or of a list."""
    x, y, z = (told.get(axis, 0.0) for axis in "xyz") if isinstance(told, Mapping) else told
    return float(x), float(y), float(z)
