"""Where a map lies on earth, as its version in force tells it: for files that other tools put on maps."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from revisit.cli.map_files import PlacedSubmap, by_session
from revisit.core.geometry import geodesy
from revisit.sdk.client import Client
from revisit.sdk.earth import OnEarth

if TYPE_CHECKING:
    from revisit.sdk.resources import MapChange

DIGITS = 9
"""Of degrees: 0.1 mm."""

_AROUND = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0))


def placed_on(earth: OnEarth, submaps: Sequence[PlacedSubmap]) -> list[PlacedSubmap]:
    """The submaps in metres east, north and up from the origin."""
    return [replace(one, T_map_submap=earth.T_enu_map @ one.T_map_submap) for one in submaps]


def frame_on_earth(http: str, map_id: str, frame: str) -> OnEarth | None:
    """Where a frame of a map lies by the version in force; None where no anchors hold it."""
    with Client(http) as client:
        return client.maps.on_earth(f"maps/{map_id}").get(frame)


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
