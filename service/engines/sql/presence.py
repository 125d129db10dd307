"""Resources under deletion are hidden: one row of `deletions` hides a session or a map with all its content.

The condition costs a look at an empty table where nothing is being deleted, once a statement.
"""

from __future__ import annotations

from functools import cache

from sqlalchemy import ColumnElement, Table, and_, exists, or_, true

from revisit.service.engines.sql import tables

SESSIONS_OF: dict[Table, tuple[str, ...]] = {
    tables.maps: (),
    tables.sessions: ("session_id",),
    tables.scans: ("session_id",),
    tables.submaps: ("session_id",),
    tables.loops: ("query_session_id", "match_session_id"),
    tables.loop_events: ("query_session_id", "match_session_id"),
    tables.map_versions: (),
    tables.session_poses: ("session_id",),
    tables.anchors: ("session_id",),
    tables.radio_readings: ("session_id",),
    tables.early_corrections: ("session_id",),
    tables.map_merges: (),
    tables.map_tiles: (),
    tables.map_files: (),
    tables.plans: (),
    tables.map_counters: (),
}
"""The tables of a map's content, and the columns that name the sessions with which a row goes."""


@cache
def present(table: Table) -> ColumnElement[bool]:
    """Whether neither the map of a row nor a session that it names is being deleted; true of rows that have no map."""
    sessions = SESSIONS_OF.get(table)
    if sessions is None:
        return true()
    deletions = tables.deletions
    doomed = deletions.alias()
    named = or_(doomed.c.session_id == "", *(doomed.c.session_id == table.c[name] for name in sessions))
    of_row = and_(doomed.c.tenant == table.c.tenant, doomed.c.map_id == table.c.map_id, named)
    anything = exists().select_from(deletions).correlate(None)
    return or_(~anything, ~exists().select_from(doomed).where(of_row).correlate(table))
