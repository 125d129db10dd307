"""Paths of calls: how `google.api.http` writes them, and how FastAPI does."""

from __future__ import annotations

from revisit.api.calls import NAMED, Call

VERSION_ID = "version_id"

ID_NAMES = {
    "maps": "map_id",
    "robots": "robot_id",
    "sessions": "session_id",
    "submaps": "submap_id",
    "anchors": "anchor_id",
    "loopClosures": "loop_id",
    "versions": VERSION_ID,
    "files": VERSION_ID,
    "merges": "merge_id",
    "plans": "plan_id",
    "tiles": "tile_id",
    "operations": "operation_id",
    "webhooks": "webhook_id",
}
"""The name of an id in paths, by the collection that it is in."""


def path_of(call: Call) -> str:
    """`/v1/maps/{map_id}/sessions/{session_id}:finish`."""
    rule = call.row.http.partition(" ")[2]
    return NAMED.sub(lambda found: "/".join(_placeholders(found["pattern"])), rule)


def resource_in(call: Call) -> tuple[str, str, tuple[str, ...]]:
    """The field that a path names (`name`, `parent`; "" for none), its pattern, and the names of the ids in it."""
    found = NAMED.search(call.row.http)
    if found is None:
        return "", "", ()
    ids = (part.strip("{}") for part in _placeholders(found["pattern"]) if part.startswith("{"))
    return found["field"], found["pattern"], tuple(ids)


def _placeholders(pattern: str) -> list[str]:
    """`maps/*` as `maps`, `{map_id}`."""
    parts = pattern.split("/")
    return [f"{{{ID_NAMES[parts[i - 1]]}}}" if part == "*" else part for i, part in enumerate(parts)]
