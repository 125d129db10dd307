"""Names of submaps as a person writes and reads them: SESSION/SUBMAP within a map."""

from __future__ import annotations

from revisit.cli.output import refuse

KINDS = ["maps", "sessions", "submaps"]


def full_name(map_id: str, written: str) -> str:
    """The resource name of SESSION/SUBMAP in a map; of a resource name, itself. Exits for anything else."""
    parts = written.split("/")
    if len(parts) == 6 and parts[::2] == KINDS:
        return written
    if len(parts) != 2 or not all(parts):
        raise refuse(f"{written} is neither SESSION/SUBMAP nor maps/MAP/sessions/SESSION/submaps/SUBMAP")
    return f"maps/{map_id}/sessions/{parts[0]}/submaps/{parts[1]}"


def map_or_session(written: str) -> str:
    """The resource name of MAP or MAP/SESSION; of a resource name, itself."""
    if written.startswith("maps/"):
        return written
    map_id, _, session_id = written.partition("/")
    return session_name(map_id, session_id) if session_id else f"maps/{map_id}"


def session_name(map_id: str, session_id: str) -> str:
    """The resource name of a session."""
    return f"maps/{map_id}/sessions/{session_id}"


def short_name(name: str) -> str:
    """SESSION/SUBMAP of a resource name; of the name of a session, SESSION."""
    return "/".join(name.split("/")[3::2])
