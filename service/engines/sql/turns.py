"""How much of the workers' time each tenant has had, in an SQL database."""

from __future__ import annotations

from functools import cache
from typing import Any

from sqlalchemy import (
    Column,
    ColumnElement,
    Connection,
    Select,
    Update,
    bindparam,
    case,
    delete,
    func,
    insert,
    select,
    update,
)

from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import TurnRecord
from revisit.service.domain.states import OperationState
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.repositories import column_values

_turns = tables.worker_turns.c


class SqlTenantTurns:
    """`TenantTurns`."""

    def __init__(self, connection: Connection) -> None:
        """All statements go through `connection`."""
        self._connection = connection

    def waiting(self) -> list[TurnRecord]:
        """See `TenantTurns`."""
        states = (OperationState.QUEUED, OperationState.RUNNING)
        found = {row[0] for state in states for row in self._connection.execute(_at_work(), {"state": state.value})}
        return [self._of(tenant) for tenant in sorted(found)]

    def latest_start_ms(self) -> int:
        """See `TenantTurns`."""
        return int(self._connection.execute(_latest_start()).scalar() or 0)

    def of_worker(self, worker_id: str) -> list[TurnRecord]:
        """See `TenantTurns`."""
        rows = self._connection.execute(_rows().where(_turns.worker_id == worker_id))
        return [TurnRecord(**row._mapping) for row in rows]

    def add(self, turn: TurnRecord, worker_id: str) -> None:
        """See `TenantTurns`."""
        # No upsert, which is not standard SQL: a worker alone adds to its rows.
        row = {**column_values(turn), "worker_id": worker_id}
        its = {"its_tenant": row["tenant"], "its_worker": worker_id}
        added = {f"more_{name}": row[name] for name in ("ran_ms", "lifted_ms", "started_ms")}
        if self._connection.execute(_added(), {**its, **added}).rowcount == 0:
            self._connection.execute(insert(tables.worker_turns), row)

    def forget(self, worker_id: str) -> None:
        """See `TenantTurns`."""
        self._connection.execute(delete(tables.worker_turns).where(_turns.worker_id == worker_id))

    def _of(self, tenant: TenantId) -> TurnRecord:
        """What a tenant has had of all workers."""
        started_ms, ran_ms, lifted_ms = self._connection.execute(_sum(), {"tenant": tenant}).one()
        return TurnRecord(tenant, started_ms or 0, ran_ms or 0, lifted_ms or 0)


@cache
def _at_work() -> Select[Any]:
    """The tenants with a job of this `state`: from one to the next in the index, however many jobs each of them has."""
    in_state = select(func.min(tables.jobs.c.tenant)).where(tables.jobs.c.state == bindparam("state"))
    found = in_state.with_only_columns(func.min(tables.jobs.c.tenant).label("tenant")).cte("found", recursive=True)
    following = in_state.where(tables.jobs.c.tenant > found.c.tenant).scalar_subquery()
    found = found.union_all(select(following).where(found.c.tenant.is_not(None)))
    return select(found.c.tenant).where(found.c.tenant.is_not(None))


@cache
def _latest_start() -> Select[Any]:
    return select(func.max(_turns.started_ms))


@cache
def _rows() -> Select[Any]:
    return select(_turns.tenant, _turns.started_ms, _turns.ran_ms, _turns.lifted_ms)


@cache
def _sum() -> Select[Any]:
    sums = (func.max(_turns.started_ms), func.sum(_turns.ran_ms), func.max(_turns.lifted_ms))
    return select(*sums).where(_turns.tenant == bindparam("tenant"))


@cache
def _added() -> Update:
    """Adds `more_ran_ms` to the row of `its_tenant` and `its_worker`; keeps the later of the other times."""
    of_worker = update(tables.worker_turns).where(
        _turns.tenant == bindparam("its_tenant"), _turns.worker_id == bindparam("its_worker")
    )
    ran_ms = _turns.ran_ms + bindparam("more_ran_ms")
    return of_worker.values(ran_ms=ran_ms, lifted_ms=_later(_turns.lifted_ms), started_ms=_later(_turns.started_ms))


def _later(column: Column[int]) -> ColumnElement[int]:
    more = bindparam(f"more_{column.name}", type_=column.type)
    return case((column < more, more), else_=column)
