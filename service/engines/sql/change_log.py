"""The change log of the maps' indexes in an SQL database."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cache
from typing import Any

from sqlalchemy import Connection, Select, bindparam, select

from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import MapRecord
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.checksums import sound_descriptor
from revisit.service.engines.sql.map_numbers import note_changes
from revisit.service.engines.sql.packed_columns import of_kinds
from revisit.service.ports.index import IndexChange

SESSION_REMOVED = "SESSION_REMOVED"
"""The kind of a change of all submaps of a session: the session's number stands in place of theirs."""

_changes, _submaps = tables.index_changes.c, tables.submaps.c
_CHANGE = [
    *(_changes.seq, _changes.kind, _changes.submap_number),
    *(_submaps.session_number, _submaps.ordinal, _submaps.position_m, _submaps.descriptor, _submaps.checksum),
]
_OF_SUBMAP = 3
"""The first column of a change that is of its submap, which may have gone."""


class SqlChangeLog:
    """`ChangeLog`."""

    def __init__(self, connection: Connection) -> None:
        """All statements go through `connection`."""
        self._connection = connection

    def record_described(self, record: MapRecord, submap_number: int) -> None:
        """See `ChangeLog`."""
        self._note(record, "DESCRIBED", [submap_number], enter=True)

    def record_removed(self, record: MapRecord, submap_numbers: Collection[int]) -> None:
        """See `ChangeLog`."""
        self._note(record, "REMOVED", sorted(submap_numbers))

    def record_session_removed(self, record: MapRecord, session_number: int) -> None:
        """See `ChangeLog`."""
        self._note(record, SESSION_REMOVED, [session_number])

    def _note(self, record: MapRecord, kind: str, numbers: Sequence[int], *, enter: bool = False) -> None:
        its = {"tenant": record.tenant, "map_number": record.number, "kind": kind}
        rows = [{**its, "submap_number": number} for number in numbers]
        note_changes(self._connection, record.tenant, record.map_id, rows, enter=enter)

    def since(self, tenant: TenantId, map_number: int, seq: int, limit: int | None = None) -> list[IndexChange]:
        """See `ChangeLog`."""
        asked = {"its_tenant": tenant, "its_map": map_number, "after": seq, "at_most": limit}
        query = _changes_since(limited=limit is not None)
        return [_change(row) for row in of_kinds(_CHANGE, self._connection.execute(query, asked), _OF_SUBMAP)]


@cache
def _changes_since(*, limited: bool) -> Select[Any]:
    """Takes `its_tenant`, `its_map` and `after`, and `at_most` where `limited`."""
    since = (
        select(*_CHANGE)
        .outerjoin_from(tables.index_changes, tables.submaps, _submaps.number == _changes.submap_number)
        .where(_changes.tenant == bindparam("its_tenant"), _changes.map_number == bindparam("its_map"))
        .where(_changes.seq > bindparam("after"))
        .order_by(_changes.seq)
    )
    return since.limit(bindparam("at_most")) if limited else since


def _change(row: Sequence[Any]) -> IndexChange:
    seq, kind, submap_number, session_number, ordinal, position_m, descriptor, checksum = row
    if kind == SESSION_REMOVED:
        return IndexChange.session_removed(seq, submap_number)
    if session_number is None:
        return IndexChange(seq, submap_number, 0, 0, (0.0, 0.0, 0.0), None)
    vector = None if kind == "REMOVED" else sound_descriptor(submap_number, descriptor, checksum)
    return IndexChange(seq, submap_number, session_number, ordinal, position_m, vector)
