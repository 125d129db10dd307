"""Where a map lies on earth, as its version in force tells it: for files that other tools put on maps."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from revisit.cli.map_files import PlacedSubmap, Points, by_session
from revisit.core.errors import BadField
from revisit.core.geometry import geodesy, se3
from revisit.core.geometry.se3 import Matrix4
from revisit.sdk.client import Client

if TYPE_CHECKING:
    from revisit.sdk.resources import MapChange

DIGITS = 9
"""Of degrees: 0.1 mm."""

_AROUND = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0))


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

    def projected(self, points: Points, epsg: int) -> Points:
        """Points (n, 3) of the map, metres, in a projected reference system: east, north, metres above the ellipsoid.

        Needs the package `pyproj`. Raises BadField where there is no such system, or it does not reach so far.
        """
        from pyproj import CRS, Transformer
        from pyproj.exceptions import CRSError

        try:
            system = CRS.from_epsg(epsg)
        except CRSError as error:
            raise BadField(f"there is no reference system EPSG:{epsg}", field="epsg") from error
        if not system.is_projected or {axis.unit_name for axis in system.axis_info} != {"metre"}:
            raise BadField(f"EPSG:{epsg} ({system.name}) is no projected system in metres", field="epsg")
        latitude, longitude, altitude = geodesy.geodetic_of_enu(self.origin, se3.apply(self.T_enu_map, points)).T
        east, north = Transformer.from_crs("EPSG:4326", system, always_xy=True).transform(longitude, latitude)
        found = np.column_stack([east, north, altitude])
        if not np.isfinite(found).all():
            raise BadField(f"EPSG:{epsg} ({system.name}) does not reach this map", field="epsg")
        return found

    def placed(self, submaps: Sequence[PlacedSubmap]) -> list[PlacedSubmap]:
        """The submaps in metres east, north and up from the origin."""
        return [replace(one, T_map_submap=self.T_enu_map @ one.T_map_submap) for one in submaps]


def frame_on_earth(http: str, map_id: str, frame: str) -> OnEarth | None:
    """Where a frame of a map lies by the version in force; None where no anchors hold it."""
    with Client(http) as client:
        origin = client.get_map(f"maps/{map_id}").origin
        version = next((one for one in client.map_versions(f"maps/{map_id}") if one.in_force), None)
    found = next((one for one in version.summary.georeferences if one.frame == frame), None) if version else None
    if found is None or origin is None:
        return None
    return OnEarth((origin.latitude_deg, origin.longitude_deg, origin.altitude_m), found.T_enu_map)


def changes_as_geojson(changes: Sequence[MapChange], earth: Mapping[str, OnEarth]) -> dict[str, Any]:
    """Changes as boxes seen from above (RFC 7946), each with what is known of it; by the frame they lie in."""
    features = []
    for one in changes:
        frame, half = earth[one.frame], 0.5 * np.array(one.extent_m)
        corners = [np.array([*(one.centre_m + half * [x, y, 0.0]), 1.0]) for x, y in _AROUND]
        places = np.stack([frame.T_enu_map @ corner for corner in corners])[:, :3]
        ring = geodesy.geodetic_of_enu(frame.origin, places).tolist()
        line = [[round(lon, DIGITS), round(lat, DIGITS), round(alt, 3)] for lat, lon, alt in ring]
        told: dict[str, Any] = {
            "kind": one.kind,
            "session": one.session,
            "stamp_ns": one.stamp_ns,
            "before_ns": one.before_ns,
        }
        told |= {"height_m": one.extent_m[2], "points": one.points}
        features.append({"type": "Feature", "properties": told, "geometry": {"type": "Polygon", "coordinates": [line]}})
    return {"type": "FeatureCollection", "features": features}


def as_geojson(placed: Sequence[PlacedSubmap], earth: OnEarth) -> str:
    """The drives as lines of WGS 84 (RFC 7946): longitude, latitude, altitude of each submap, one line a session."""
    features = []
    for session, drive in by_session(placed).items():
        places = np.stack([earth.T_enu_map @ T_map_submap[:, 3] for T_map_submap in drive.T_map_submap])[:, :3]
        positions = geodesy.geodetic_of_enu(earth.origin, places)
        line = [[round(lon, DIGITS), round(lat, DIGITS), round(alt, 3)] for lat, lon, alt in positions.tolist()]
        lone = {"type": "Point", "coordinates": line[0]}
        geometry = {"type": "LineString", "coordinates": line} if len(line) > 1 else lone
        features.append({"type": "Feature", "properties": {"session": session}, "geometry": geometry})
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n"
