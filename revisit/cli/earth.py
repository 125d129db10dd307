"""Where a map lies on earth, as its version in force tells it: for files that other tools put on maps."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from revisit.cli.map_files import PlacedSubmap, by_session
from revisit.core.geometry import geodesy
from revisit.sdk.client import Client
from revisit.sdk.earth import OnEarth

if TYPE_CHECKING:
    from revisit.sdk.resources import MapChange

Array64 = NDArray[np.float64]

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
        rings = [[ring] for ring in _rings(geodesy.geodetic_of_enu(frame.origin, places))]
        told: dict[str, Any] = {
            "kind": one.kind,
            "session": one.session,
            "stamp_ns": one.stamp_ns,
            "before_ns": one.before_ns,
        }
        told |= {"height_m": one.extent_m[2], "points": one.points}
        features.append({"type": "Feature", "properties": told, "geometry": _geometry("Polygon", rings)})
    return {"type": "FeatureCollection", "features": features}


def as_geojson(placed: Sequence[PlacedSubmap], earth: OnEarth) -> str:
    """The drives as lines of WGS 84 (RFC 7946): longitude, latitude, altitude of each submap, one line a session."""
    features = []
    for session, drive in by_session(placed).items():
        places = np.stack([earth.T_enu_map @ T_map_submap[:, 3] for T_map_submap in drive.T_map_submap])[:, :3]
        lines = _lines(geodesy.geodetic_of_enu(earth.origin, places))
        lone = {"type": "Point", "coordinates": lines[0][0]}
        geometry = _geometry("LineString", lines) if len(places) > 1 else lone
        features.append({"type": "Feature", "properties": {"session": session}, "geometry": geometry})
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n"


def _geometry(kind: str, parts: list[Any]) -> dict[str, Any]:
    """A geometry of one part, or of several."""
    return (
        {"type": kind, "coordinates": parts[0]} if len(parts) == 1 else {"type": f"Multi{kind}", "coordinates": parts}
    )


def _lines(positions: Array64) -> list[list[list[float]]]:
    """A line through geodetic positions (n, 3), as GeoJSON has it: cut where it crosses longitude 180."""
    lines: list[list[list[float]]] = [[]]
    way = _unwound(positions)
    for here, there in itertools.zip_longest(way, way[1:]):
        lines[-1].append(_told(here, _turn(here)))
        if there is not None and _turn(here) != _turn(there):
            crossing = _crossing(here, there, 360.0 * max(_turn(here), _turn(there)) - 180.0)
            lines[-1].append(_told(crossing, _turn(here)))
            lines.append([_told(crossing, _turn(there))])
    return lines


def _rings(positions: Array64) -> list[list[list[float]]]:
    """A closed convex ring through geodetic positions (n, 3): cut in two where longitude 180 crosses it."""
    way = _unwound(positions)
    rings = []
    for turn in sorted({_turn(one) for one in way}):
        ring = _clipped(_clipped(way, 360.0 * turn - 180.0, 1.0), 360.0 * turn + 180.0, -1.0)
        rings.append([_told(one, turn) for one in ring])
    return rings


def _clipped(ring: list[Array64], edge_deg: float, side: float) -> list[Array64]:
    """The part of a ring that lies east of a longitude (side 1), or west of it (-1); closed."""
    left = list[Array64]()
    for here, there in itertools.pairwise(ring):
        inside = [side * (one[1] - edge_deg) >= 0.0 for one in (here, there)]
        left += [here] if inside[0] else []
        left += [_crossing(here, there, edge_deg)] if inside[0] != inside[1] else []
    return [*left, *left[:1]]


def _unwound(positions: Array64) -> list[Array64]:
    """The positions (3,), latitude, longitude, altitude, with longitudes that go on beyond 180 degrees."""
    return list(np.column_stack([positions[:, 0], np.unwrap(positions[:, 1], period=360.0), positions[:, 2]]))


def _turn(position: Array64) -> int:
    """How often longitude 180 lies between a position and the middle of the map of the world."""
    return math.floor((float(position[1]) + 180.0) / 360.0)


def _crossing(here: Array64, there: Array64, longitude_deg: float) -> Array64:
    """Where the way between two positions crosses a longitude."""
    at = here + (longitude_deg - here[1]) / (there[1] - here[1]) * (there - here)
    return np.array([at[0], longitude_deg, at[2]])


def _told(position: Array64, turn: int) -> list[float]:
    """Longitude, latitude and altitude, rounded."""
    latitude, longitude, altitude = position.tolist()
    return [round(longitude - 360.0 * turn, DIGITS), round(latitude, DIGITS), round(altitude, 3)]
