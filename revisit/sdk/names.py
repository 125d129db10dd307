"""Names of resources: a caller's short form as the service's full name."""

from __future__ import annotations

from typing import Any

from revisit.sdk.errors import ErrorDetails, InvalidArgument

MAP = "maps/MAP"
ROBOT = "robots/ROBOT"
OPERATION = "operations/OPERATION"
WEBHOOK = "webhooks/WEBHOOK"
SESSION = "maps/MAP/sessions/SESSION"
SUBMAP = "maps/MAP/sessions/SESSION/submaps/SUBMAP"
ANCHOR = "maps/MAP/sessions/SESSION/anchors/ANCHOR"
LOOP_CLOSURE = "maps/MAP/loopClosures/LOOP"
VERSION = "maps/MAP/versions/VERSION"
MERGE = "maps/MAP/merges/MERGE"
MAP_FILE = "maps/MAP/files/VERSION"
PLAN = "maps/MAP/plans/PLAN"
TILE = "maps/MAP/versions/VERSION/tiles/TILE"
ANY = f"{MAP}, {SESSION} or {SUBMAP}"


def name_of(resource: Any, form: str) -> str:
    """The name of a resource, of its name, or of its id where its `form` holds no other id.

    Raises InvalidArgument for an id that is not enough.
    """
    name = resource if isinstance(resource, str) else str(resource.name)
    if "/" in name:
        return name
    if name and form.count("/") == 1:
        return f"{form.partition('/')[0]}/{name}"
    message = f"{name!r} is not a whole name, which has the form {form}"
    raise InvalidArgument(ErrorDetails("INVALID_ARGUMENT", "BAD_FIELD", message, field="name"))


def name_in_map(map_: Any, session: Any) -> str:
    """The name of a session, which may be given by its id."""
    name = session if isinstance(session, str) else str(session.name)
    return name if "/" in name else f"{name_of(map_, MAP)}/sessions/{name}"
