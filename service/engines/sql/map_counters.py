"""Rows of counters: made with a map, read by those who watch, gone with it."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from typing import Any

from sqlalchemy import Connection, Select, bindparam, delete, insert, select, tuple_, update

from revisit.service.domain.events import DAMAGED
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import MapRecord
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.packed_columns import require_values
from revisit.service.engines.sql.presence import present
from revisit.service.engines.sql.repositories import Scalar, SqlRepository, matches, of_tenant

NAMES = ("changes", "events", "submaps")

FORMER = ""
"""In place of a map's id: the highest numbers of the tenant's maps that were deleted. A new map goes on from there, so
that nobody takes it for one that had its id before."""


class SqlMaps(SqlRepository[MapRecord]):
    """Maps, each with its counters."""

    def add(self, record: MapRecord) -> MapRecord:
        """See `Repository`."""
        added = super().add(record)
        start = self._highest(added.tenant, FORMER)
        row = {"tenant": added.tenant, "map_id": added.map_id, "forgotten": 0, **start}
        self._connection.execute(insert(tables.map_counters), row)
        return added

    def delete(self, tenant: TenantId, **equals: Scalar) -> int:
        """See `Repository`."""
        asked = of_tenant(tenant, equals)
        gone = select(tables.maps.c.map_id).where(matches(tables.maps, asked))
        for map_id in self._connection.execute(gone, asked).scalars().all():
            self._forget(tenant, map_id)
        return super().delete(tenant, **equals)

    def _forget(self, tenant: TenantId, map_id: str) -> None:
        counters = tables.map_counters
        own, former = (self._highest(tenant, one) for one in (map_id, FORMER))
        highest = {name: max(own[name], former[name]) for name in NAMES}
        kept = update(counters).where(counters.c.tenant == tenant, counters.c.map_id == FORMER).values(highest)
        if self._connection.execute(kept).rowcount == 0:
            first = {"tenant": tenant, "map_id": FORMER, "forgotten": 0, **highest}
            self._connection.execute(insert(counters), first)
        for table in (counters, tables.webhook_positions):
            gone = delete(table).where(table.c.tenant == tenant, table.c.map_id == map_id)
            self._connection.execute(gone)

    def _highest(self, tenant: TenantId, map_id: str) -> dict[str, int]:
        row = self._connection.execute(_counters(), {"its_tenant": tenant, "its_map": map_id}).one_or_none()
        kept = {name: 0 if row is None else getattr(row, name) for name in NAMES}
        # Of a damaged row nothing is known: the map goes all the same.
        return {name: number if isinstance(number, int) else 0 for name, number in kept.items()}


def last_events(connection: Connection, maps: Collection[tuple[TenantId, str]]) -> dict[tuple[TenantId, str], int]:
    """The last number of an event of each of these maps that is there and is not being deleted; or DAMAGED."""
    found = connection.execute(_last_events(), {"its_maps": list(maps)}) if maps else ()
    known = ((*its, events if isinstance(events, int) else DAMAGED) for *its, events in found)
    return {(TenantId(tenant), map_id): events for tenant, map_id, events in known}


def forgotten_events(connection: Connection, tenant: TenantId, map_id: str) -> int:
    """The highest number of an event of the map that is no longer kept; 0 for none."""
    row = connection.execute(_counters(), {"its_tenant": tenant, "its_map": map_id}).one_or_none()
    if row is None:
        return 0
    require_values([tables.map_counters.c.forgotten], [row.forgotten])
    return int(row.forgotten)


@cache
def _counters() -> Select[Any]:
    counters = tables.map_counters
    return select(counters).where(
        counters.c.tenant == bindparam("its_tenant"), counters.c.map_id == bindparam("its_map")
    )


@cache
def _last_events() -> Select[Any]:
    counters = tables.map_counters
    maps: Any = bindparam("its_maps", expanding=True)
    named = tuple_(counters.c.tenant, counters.c.map_id).in_(maps)
    return select(counters.c.tenant, counters.c.map_id, counters.c.events).where(named, present(counters))
