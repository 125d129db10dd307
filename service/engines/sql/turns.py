"""How much of the workers' time each tenant has had, in an SQL database."""

from __future__ import annotations

from functools import cache
from typing import Any

import structlog
from sqlalchemy import (
    BigInteger,
    Column,
    ColumnElement,
    Connection,
    Select,
    Update,
    bindparam,
    case,
    cast,
    delete,
    func,
    insert,
    select,
    union,
    update,
)

from revisit.service.domain.records import TurnRecord
from revisit.service.domain.states import OperationState
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.engine import DatabaseEngine
from revisit.service.engines.sql.packed_columns import fits, require_values
from revisit.service.engines.sql.repositories import column_values
from revisit.service.ports.job_queue import Standing

_turns = tables.worker_turns.c
_COLUMNS = (_turns.tenant, _turns.started_ms, _turns.ran_ms, _turns.lifted_ms)

_log = structlog.get_logger(__name__)


class SqlTenantTurns:
    """`TenantTurns`."""

    def __init__(self, connection: Connection, engine: DatabaseEngine) -> None:
        """All statements go through `connection`."""
        self._connection = connection
        self._engine = engine

    def standing(self) -> Standing:
        """See `TenantTurns`."""
        turns, latest_ms, first_ms = [], 0, None
        for *turn, latest, first in self._connection.execute(_standing()):
            require_values((*_COLUMNS, _turns.started_ms), (*turn, latest or 0))
            turns.append(TurnRecord(*turn))
            latest_ms, first_ms = int(latest or 0), first
        # A lease whose end cannot be read counts as lost: whoever looks for lost ones meets the damaged row.
        return Standing(turns, latest_ms, first_ms if first_ms is None or isinstance(first_ms, int) else 0)

    def of_worker(self, worker_id: str) -> list[TurnRecord]:
        """See `TenantTurns`."""
        query = select(*_COLUMNS).where(_turns.worker_id == worker_id)
        with self._engine.any_text(self._connection):
            rows = self._connection.execute(query).all()
        return [TurnRecord(*row) for row in rows if fits(_COLUMNS, row)]

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

    def mend(self) -> None:
        """See `TenantTurns`."""
        with self._engine.any_text(self._connection):
            rows = self._connection.execute(select(tables.worker_turns)).all()
        if not all(fits(tables.worker_turns.columns, row) for row in rows):
            _log.error("turns_begin_anew", reason="a row of worker_turns is damaged")
            self._connection.execute(delete(tables.worker_turns))


@cache
def _standing() -> Select[Any]:
    """The tenants with a job that waits or runs, and what each has had of all workers; with each the latest start of
    all, and the first end of a lease of a running job.
    """
    tenants = union(_at_work(OperationState.QUEUED), _at_work(OperationState.RUNNING)).subquery()
    ran_ms = cast(func.sum(_turns.ran_ms), BigInteger)
    had = (func.coalesce(sum_, 0) for sum_ in (func.max(_turns.started_ms), ran_ms, func.max(_turns.lifted_ms)))
    joined = tenants.outerjoin(tables.worker_turns, _turns.tenant == tenants.c.tenant)
    latest = select(func.max(tables.worker_turns.alias().c.started_ms)).scalar_subquery()
    running = tables.jobs.c.state == OperationState.RUNNING.value
    first_end = select(func.min(tables.jobs.c.lease_expires_ms)).where(running).scalar_subquery()
    of_tenant = select(tenants.c.tenant, *had, latest, first_end).select_from(joined).group_by(tenants.c.tenant)
    return of_tenant.order_by(tenants.c.tenant)


def _at_work(state: OperationState) -> Select[Any]:
    """The tenants with a job of this state: from one to the next in the index, however many jobs each of them has."""
    in_state = select(func.min(tables.jobs.c.tenant)).where(tables.jobs.c.state == state.value)
    first = in_state.with_only_columns(func.min(tables.jobs.c.tenant).label("tenant"))
    found = first.cte(f"found_{state.value.lower()}", recursive=True)
    following = in_state.where(tables.jobs.c.tenant > found.c.tenant).scalar_subquery()
    found = found.union_all(select(following).where(found.c.tenant.is_not(None)))
    return select(found.c.tenant).where(found.c.tenant.is_not(None))


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
