"""How much of the workers' time each tenant has had, in an SQL database."""

from __future__ import annotations

from functools import cache
from typing import Any

from sqlalchemy import Connection, Select, Update, bindparam, func, insert, select, update

from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import TurnRecord
from revisit.service.domain.states import OperationState
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.repositories import column_values


class SqlTenantTurns:
    """`TenantTurns`."""

    def __init__(self, connection: Connection) -> None:
        """All statements go through `connection`."""
        self._connection = connection

    def waiting(self) -> list[TurnRecord]:
        """See `TenantTurns`."""
        # One query per state: each walks an index that holds all it needs.
        states = (OperationState.QUEUED, OperationState.RUNNING)
        found = {row[0] for state in states for row in self._connection.execute(_at_work(), {"state": state.value})}
        return [self.of(tenant) for tenant in sorted(found)]

    def of(self, tenant: TenantId) -> TurnRecord:
        """See `TenantTurns`."""
        row = self._connection.execute(_turn(), {"tenant": tenant}).first()
        return TurnRecord(tenant) if row is None else TurnRecord(**row._mapping)

    def latest_start_ms(self) -> int:
        """See `TenantTurns`."""
        return int(self._connection.execute(_latest_start()).scalar() or 0)

    def keep(self, turn: TurnRecord) -> None:
        """See `TenantTurns`."""
        # No upsert, which is not standard SQL: the transaction holds the lock of the writers.
        row = column_values(turn)
        times = {name: value for name, value in row.items() if name != "tenant"}
        if self._connection.execute(_of_tenant(), {"its_tenant": turn.tenant, **times}).rowcount == 0:
            self._connection.execute(insert(tables.tenant_turns), row)


@cache
def _at_work() -> Select[Any]:
    return select(tables.jobs.c.tenant).where(tables.jobs.c.state == bindparam("state")).distinct()


@cache
def _latest_start() -> Select[Any]:
    return select(func.max(tables.tenant_turns.c.started_ms))


@cache
def _of_tenant() -> Update:
    """Overwrites the turn of tenant `its_tenant`."""
    return update(tables.tenant_turns).where(tables.tenant_turns.c.tenant == bindparam("its_tenant"))


@cache
def _turn() -> Select[Any]:
    return select(tables.tenant_turns).where(tables.tenant_turns.c.tenant == bindparam("tenant"))
