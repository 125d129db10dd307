"""Places of a map on earth, where anchors hold it: latitude, longitude, altitude and heading of a pose."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry import geodesy, se3
from revisit.core.geometry.se3 import Matrix4

if TYPE_CHECKING:
    from pyproj import CRS


MOST_FROM_ORIGIN_M = 100_000.0
"""A place so far from the origin of a map is a mistake."""


@dataclass(frozen=True)
class GeodeticPose:
    """Where something is on earth, WGS 84, and the direction of its x axis, degrees clockwise from north, 0 to 360.

    `altitude_m` is above the ellipsoid, not above the sea.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    heading_deg: float


@dataclass(frozen=True)
class OnEarth:
    """A frame of a map on earth: T_enu_map (4, 4) into metres east, north and up from `origin`, latitude, longitude
    (degrees) and altitude (metres) of WGS 84.
    """

    origin: tuple[float, float, float]
    T_enu_map: Matrix4

    @property
    def T_ecef_map(self) -> Matrix4:
        """Into earth-centred coordinates."""
        return np.asarray(geodesy.T_ecef_enu(self.origin) @ self.T_enu_map)

    def pose(self, T_map: Matrix4) -> GeodeticPose:
        """A pose (4, 4) in the frame, such as `in_map.T_map` of an answer, on earth."""
        T_ecef = self.T_ecef_map @ se3.validated(T_map)
        latitude, longitude, altitude = geodesy.geodetic(T_ecef[None, :3, 3])[0].tolist()
        T_enu = se3.inverse(geodesy.T_ecef_enu((latitude, longitude, altitude))) @ T_ecef
        heading_deg = math.degrees(math.atan2(T_enu[0, 0], T_enu[1, 0])) % 360.0
        # A heading that is less than north by a rounding is 360.0 by then.
        return GeodeticPose(latitude, longitude, altitude, heading_deg % 360.0)

    def place(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """x and y in the frame, metres, of a place on earth at the altitude of the origin.

        Raises BadField where it is none, or 100 km from the origin or more: longitude and latitude may be exchanged.
        """
        if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0):
            raise BadField(f"{latitude_deg}, {longitude_deg} is no latitude and longitude", field="pins")
        at = geodesy.enu(self.origin, [(latitude_deg, longitude_deg, self.origin[2])])
        if np.linalg.norm(at) >= MOST_FROM_ORIGIN_M:
            raise BadField(f"{latitude_deg}, {longitude_deg} is 100 km from the map or more", field="pins")
        x, y, _ = se3.apply(se3.inverse(self.T_enu_map), at)[0].tolist()
        return x, y

    def projected(self, points: NDArray[np.float64], epsg: int) -> NDArray[np.float64]:
        """Points (n, 3) of the map, metres, in a projected reference system: east, north, metres above the ellipsoid.

        Needs the package `pyproj` (extra `crs`). Raises BadField where there is no such system of east and north, or
        it does not reach so far.
        """
        from pyproj import Transformer

        system = _system(epsg)
        latitude, longitude, altitude = geodesy.geodetic_of_enu(self.origin, se3.apply(self.T_enu_map, points)).T
        east, north = Transformer.from_crs("EPSG:4326", system, always_xy=True).transform(longitude, latitude)
        found = np.column_stack([east, north, altitude])
        if not np.isfinite(found).all():
            raise BadField(f"EPSG:{epsg} ({system.name}) does not reach this map", field="epsg")
        return found


def wkt(epsg: int) -> str:
    """The projected reference system in the words of OGC 01-009, as files of LAS 1.4 name it.

    Needs the package `pyproj` (extra `crs`). Raises BadField where there is no such system of east and north.
    """
    return str(_system(epsg).to_wkt("WKT1_GDAL"))


def _system(epsg: int) -> CRS:
    """The projected system of east and north, metres. Raises BadField."""
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        system = CRS.from_epsg(epsg)
    except CRSError as error:
        raise BadField(f"there is no reference system EPSG:{epsg}", field="epsg") from error
    if not system.is_projected or {axis.unit_name for axis in system.axis_info} != {"metre"}:
        raise BadField(f"EPSG:{epsg} ({system.name}) is no projected system in metres", field="epsg")
    if system.is_compound:
        plain = system.sub_crs_list[0].to_epsg()
        message = f"EPSG:{epsg} ({system.name}) has heights of its own, and a map has those above the ellipsoid"
        raise BadField(f"{message}: give EPSG:{plain}" if plain else message, field="epsg")
    if "west" in {axis.direction for axis in system.axis_info}:
        raise BadField(f"EPSG:{epsg} ({system.name}) counts to the west and the south", field="epsg")
    return system
