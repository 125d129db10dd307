"""The log of events in an SQL database."""

from __future__ import annotations

from functools import cache
from typing import Any

from sqlalchemy import Connection, Select, bindparam, delete, func, or_, select, true, update

from revisit.service.domain.events import EventRecord
from revisit.service.domain.identity import TenantId
from revisit.service.domain.states import EventKind
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.engine import DatabaseEngine
from revisit.service.engines.sql.repositories import column_values, new_row


class SqlEventLog:
    """`EventLog`."""

    def __init__(self, connection: Connection, engine: DatabaseEngine) -> None:
        """All statements go through `connection`, a connection of `engine`."""
        self._connection = connection
        self._engine = engine

    def record(self, event: EventRecord) -> None:
        """See `EventLog`."""
        self._engine.number_in_commit_order(self._connection, tables.events)
        row = column_values(event)
        row.pop("number")
        self._connection.execute(new_row(tables.events), row)

    def following(self, tenant: TenantId, number: int, limit: int, map_id: str | None = None) -> list[EventRecord]:
        """See `EventLog`."""
        asked = {"its_tenant": tenant, "seen": number, **({} if map_id is None else {"its_map": map_id})}
        rows = self._connection.execute(_following(map_id is not None).limit(limit), asked)
        return [EventRecord(**row._mapping) for row in rows]

    def newest_of_maps(self, number: int) -> list[EventRecord]:
        """See `EventLog`."""
        rows = self._connection.execute(_newest_of_maps(), {"seen": number})
        return [EventRecord(**row._mapping) for row in rows]

    def last_number(self) -> int:
        """See `EventLog`."""
        return self._engine.last_number(self._connection, tables.events)

    def forget(self, kept: int) -> int:
        """See `EventLog`."""
        events = tables.events.c
        crowded = select(events.tenant).group_by(events.tenant).having(func.count() > kept + 1)
        return sum(self._forget_of(tenant, kept) for tenant in self._connection.execute(crowded).scalars().all())

    def _forget_of(self, tenant: TenantId, kept: int) -> int:
        events = tables.events.c
        own = events.tenant == tenant
        last = select(events.number).where(own).order_by(events.number.desc()).offset(kept).limit(1)
        cut = self._connection.execute(last).scalar_one()
        gone = self._connection.execute(delete(tables.events).where(own, events.number < cut)).rowcount
        stands_for = {"kind": EventKind.FORGOTTEN.value, "map_id": "", "subject": ""}
        self._connection.execute(update(tables.events).where(events.number == cut).values(stands_for))
        return gone


@cache
def _newest_of_maps() -> Select[Any]:
    """Takes `seen`."""
    events = tables.events.c
    newest = select(func.max(events.number)).where(events.number > bindparam("seen"))
    of_maps = newest.group_by(events.tenant, events.map_id)
    return select(tables.events).where(events.number.in_(of_maps)).order_by(events.number)


@cache
def _following(of_map: bool) -> Select[Any]:
    """Takes `its_tenant`, `seen` and, with `of_map`, `its_map`."""
    events = tables.events.c
    wanted = or_(events.map_id == bindparam("its_map"), events.map_id == "") if of_map else true()
    its = events.tenant == bindparam("its_tenant")
    return select(tables.events).where(its, wanted, events.number > bindparam("seen")).order_by(events.number)
