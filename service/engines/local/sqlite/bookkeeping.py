"""Damaged rows that a store keeps for itself begin anew, so that one is in nobody's way.

The counters of a map go on far above every number that was given. A blob that waits for its collection is forgotten:
the sweep finds it as one that no row names.
"""

from __future__ import annotations

import sqlite3
from typing import Any, cast

import structlog
from sqlalchemy import Connection, Table, delete, func, insert, literal_column, select

from revisit.service.engines.local.sqlite.row_checksums import any_text, is_whole
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.map_counters import FORMER

FAR = 1_000_000
"""So far above the numbers of the rows that are there: those of rows that are gone are not known any more."""

log = structlog.get_logger(__name__)


def mend_bookkeeping(connection: Connection) -> None:
    """Replace or forget the damaged rows in this transaction."""
    for row in _taken_out(connection, tables.unreferenced_blobs):
        log.error("blob_to_collect_forgotten", tenant=str(row["tenant"]), sha256=str(row["sha256"]))
    for row in _taken_out(connection, tables.map_counters):
        log.error("counters_begin_anew", tenant=str(row["tenant"]), map_id=str(row["map_id"]))
        if row["map_id"] == FORMER and isinstance(row["tenant"], str):
            former = {"tenant": row["tenant"], "map_id": FORMER, "forgotten": 0}
            connection.execute(insert(tables.map_counters), {**former, "changes": FAR, "events": FAR, "submaps": FAR})
    maps, counters = tables.maps.c, tables.map_counters.c
    own = select(counters.map_id).where(counters.tenant == maps.tenant, counters.map_id == maps.map_id).exists()
    for one in connection.execute(select(maps.tenant, maps.map_id, maps.number).where(~own)).all():
        connection.execute(insert(tables.map_counters), _anew(connection, *one))


def _taken_out(connection: Connection, table: Table) -> list[dict[str, Any]]:
    """The damaged rows of a table, which are deleted."""
    with any_text(cast(sqlite3.Connection, connection.connection.driver_connection)):
        stored = connection.exec_driver_sql(f"SELECT rowid AS row, * FROM {table.name}").mappings().all()  # noqa: S608
    found = []
    for row in map(dict, stored):
        number = row.pop("row")
        if not is_whole(table.name, row):
            connection.execute(delete(table).where(literal_column("rowid") == number))
            found.append(row)
    return found


def _anew(connection: Connection, tenant: str, map_id: str, number: int) -> dict[str, Any]:
    """The counters of a map. Events that were forgotten before the damage count as told."""

    def above(table: Table, **its: Any) -> int:
        of_map = (table.c[name] == value for name, value in its.items())
        whole = select(func.max(table.c.seq)).where(*of_map, func.typeof(table.c.seq) == "integer")
        return FAR + int(connection.execute(whole).scalar() or 0)

    first = select(func.min(tables.events.c.seq)).where(
        tables.events.c.tenant == tenant, tables.events.c.map_id == map_id
    )
    return {
        "tenant": tenant,
        "map_id": map_id,
        "forgotten": max(0, int(connection.execute(first).scalar() or 1) - 1),
        "changes": above(tables.index_changes, map_number=number),
        "events": above(tables.events, tenant=tenant, map_id=map_id),
        "submaps": above(tables.submaps, tenant=tenant, map_id=map_id),
    }
