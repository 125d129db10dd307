"""Resource names to keys: `maps/{map}/sessions/{session}/submaps/{submap}` and the like."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from revisit.core.errors import BadField
from revisit.service.domain import limits
from revisit.service.domain.identity import SessionKey, SubmapKey
from revisit.service.ports.map_tiles import NOW, Moment, TileKey


def segments(name: str, pattern: str, field: str) -> list[str]:
    """The ids of `name` at the `*` of `pattern`, e.g. `maps/*`. Raises BadField naming `field` where it differs."""
    parts, wanted = name.split("/"), pattern.split("/")
    matches = len(parts) == len(wanted) and all(w in ("*", p) for p, w in zip(parts, wanted, strict=True))
    if not matches or not all(parts):
        raise BadField(f"{field} must look like {pattern}", field=field)
    return [part for part, want in zip(parts, wanted, strict=True) if want == "*"]


def map_id(name: str, field: str = "name") -> str:
    """Of `maps/{map}`."""
    return segments(name, "maps/*", field)[0]


def robot_id(name: str, field: str = "name") -> str:
    """Of `robots/{robot}`."""
    return segments(name, "robots/*", field)[0]


def session_key(name: str, field: str = "name") -> SessionKey:
    """Of `maps/{map}/sessions/{session}`."""
    return SessionKey(*segments(name, "maps/*/sessions/*", field))


def submap_key(name: str, field: str = "name") -> SubmapKey:
    """Of `maps/{map}/sessions/{session}/submaps/{submap}`."""
    return SubmapKey(*segments(name, "maps/*/sessions/*/submaps/*", field))


def loop_key(name: str, field: str = "name") -> tuple[str, str]:
    """Map id and loop id of `maps/{map}/loopClosures/{loop_closure}`."""
    of_map, loop_id = segments(name, "maps/*/loopClosures/*", field)
    return of_map, loop_id


def version_key(name: str, field: str = "name") -> tuple[str, int]:
    """Map id and version of `maps/{map}/versions/{version}`."""
    of_map, version = segments(name, "maps/*/versions/*", field)
    return of_map, version_number(version, field)


def tile_key(name: str, field: str = "name", moment: Moment = NOW) -> TileKey:
    """Of `maps/{map}/versions/{version}/tiles/{tile}`, at a moment."""
    of_map, version, tile = segments(name, "maps/*/versions/*/tiles/*", field)
    return TileKey.of(of_map, version_number(version, field), tile, moment)


def file_key(name: str, field: str = "name") -> tuple[str, int]:
    """Map id and version of `maps/{map}/files/{version}`."""
    of_map, version = segments(name, "maps/*/files/*", field)
    return of_map, version_number(version, field)


def plan_key(name: str, field: str = "name") -> tuple[str, str]:
    """Map id and plan id of `maps/{map}/plans/{plan}`."""
    of_map, plan_id = segments(name, "maps/*/plans/*", field)
    return of_map, plan_id


def merge_source(name: str, field: str = "source") -> tuple[str, str | None]:
    """Map id, and session id or None, of `maps/{map}` or `maps/{map}/sessions/{session}`."""
    if name.count("/") == 1:
        return map_id(name, field), None
    key = session_key(name, field)
    return key.map_id, key.session_id


def version_number(text: str, field: str = "version") -> int:
    """The number of a version. Raises BadField where it is none."""
    if not (text.isascii() and text.isdigit() and len(text) < 20):
        raise BadField(f"{field} must name a version by its number", field=field)
    return limits.MAP_VERSION.validated(int(text), field)


def operation_id(name: str) -> str:
    """Of `operations/{operation}`."""
    return segments(name, "operations/*", "name")[0]


def key_of(name: str, pattern: str, field: str) -> tuple[Any, ...]:
    """The arguments by which use cases name the resource of a pattern. Raises BadField naming `field`."""
    ids = segments(name, pattern, field)
    if pattern in _KEYS:
        return (_KEYS[pattern](*ids),)
    return (*ids[:-1], version_number(ids[-1], field)) if pattern in _BY_VERSION else tuple(ids)


_KEYS: Mapping[str, type] = {"maps/*/sessions/*": SessionKey, "maps/*/sessions/*/submaps/*": SubmapKey}
_BY_VERSION = ("maps/*/versions/*", "maps/*/files/*")


def session_id_in(map_name: str, name: str, field: str) -> str | None:
    """The session id of `name`, which must be of the map; None where `name` is empty. Raises BadField."""
    if not name:
        return None
    key = session_key(name, field)
    if f"maps/{key.map_id}" != map_name:
        raise BadField(f"{field} must be a session of {map_name}", field=field)
    return key.session_id


def submap_key_in(map_name: str, name: str, field: str) -> SubmapKey:
    """The key of a submap, which must be of the map. Raises BadField."""
    key = submap_key(name, field)
    if f"maps/{key.map_id}" != map_name:
        raise BadField(f"{field} must be a submap of {map_name}", field=field)
    return key
