"""The log of events in an SQL database."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from typing import Any

from sqlalchemy import Connection, Select, bindparam, delete, func, select, update

from revisit.service.domain.events import EventRecord, forgotten_until
from revisit.service.domain.identity import TenantId
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.map_counters import forgotten_events, last_events
from revisit.service.engines.sql.map_numbers import note_event


class SqlEventLog:
    """`EventLog`."""

    def __init__(self, connection: Connection) -> None:
        """All statements go through `connection`."""
        self._connection = connection

    def record(self, event: EventRecord, *, accepts: bool = False) -> None:
        """See `EventLog`."""
        row = {name: getattr(event, name) for name in ("tenant", "map_id", "kind", "subject")}
        note_event(self._connection, event.tenant, event.map_id, row, accepts=accepts)

    def following(self, tenant: TenantId, map_id: str, number: int, limit: int) -> list[EventRecord]:
        """See `EventLog`."""
        forgotten = forgotten_events(self._connection, tenant, map_id)
        asked = {"its_tenant": tenant, "its_map": map_id, "seen": max(number, forgotten), "at_most": limit}
        sign = [forgotten_until(tenant, map_id, forgotten)] if number < forgotten else []
        rows = self._connection.execute(_following(), {**asked, "at_most": limit - len(sign)})
        return sign + [EventRecord(**row._mapping) for row in rows]

    def last_numbers(self, maps: Collection[tuple[TenantId, str]]) -> dict[tuple[TenantId, str], int]:
        """See `EventLog`."""
        return last_events(self._connection, maps)

    def forget(self, kept: int) -> int:
        """See `EventLog`."""
        events = tables.events.c
        crowded = select(events.tenant).group_by(events.tenant).having(func.count() > kept)
        return sum(self._forget_of(tenant, kept) for tenant in self._connection.execute(crowded).scalars().all())

    def _forget_of(self, tenant: TenantId, kept: int) -> int:
        events, counters = tables.events.c, tables.map_counters
        own = events.tenant == tenant
        last = select(events.number).where(own).order_by(events.number.desc()).offset(kept).limit(1)
        old = events.number <= self._connection.execute(last).scalar_one()
        newest = select(events.map_id, func.max(events.seq)).where(own, old).group_by(events.map_id)
        for map_id, seq in self._connection.execute(newest.order_by(events.map_id)).all():
            of_map = update(counters).where(counters.c.tenant == tenant, counters.c.map_id == map_id)
            self._connection.execute(of_map.values(forgotten=seq))
        return self._connection.execute(delete(tables.events).where(own, old)).rowcount


@cache
def _following() -> Select[Any]:
    """The next `at_most` events of map `its_map` of `its_tenant` above number `seen`."""
    events = tables.events.c
    columns = (events.tenant, events.map_id, events.kind, events.subject, events.seq.label("number"))
    its = (events.tenant == bindparam("its_tenant"), events.map_id == bindparam("its_map"))
    query = select(*columns).where(*its, events.seq > bindparam("seen")).order_by(events.seq)
    return query.limit(bindparam("at_most"))
