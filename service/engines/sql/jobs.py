"""Jobs in an SQL database: the next to run, those with an expired lease, those long finished."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from typing import Any

from sqlalchemy import BindParameter, ColumnElement, Select, and_, bindparam, delete, func, or_, select, text

from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord
from revisit.service.domain.states import OperationState
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.repositories import SqlRepository, changed_row, column_values
from revisit.service.ports.repositories import Waiting


class SqlJobs(SqlRepository[JobRecord]):
    """`JobRepository`."""

    def next_runnable(
        self, now_ms: int, tenant: TenantId, *, lost: bool = True, hold: bool = False
    ) -> JobRecord | None:
        """See `LeasableJobs`."""
        asked = {"now_ms": now_ms, "tenant": tenant}
        # One query per state: each walks the index of its state, however many jobs have finished.
        states = (False, True) if lost else (False,)
        rows = [self._connection.execute(_runnable(state, hold), asked).first() for state in states]
        first = [self._of(row) for row in rows if row is not None]
        return min(first, key=lambda job: (job.priority, job.number), default=None)

    def fail_damaged(self, code: str, message: str, finished_at_ns: int) -> list[JobRecord]:
        """See `LeasableJobs`. What a damaged row held beside its numbers is gone."""
        number, unended = tables.jobs.c.number, select(tables.jobs).where(_unended()).order_by(tables.jobs.c.number)
        numbers = self._connection.execute(unended.with_only_columns(number)).scalars().all()
        jobs = zip(numbers, self._each(self._connection.execute(unended)), strict=True)
        damaged = [its for its, job in jobs if job is None]
        ended = {"state": OperationState.FAILED.value, "finished_at_ns": finished_at_ns}
        lost: dict[str, Any] = {
            "payload": {},
            "result": None,
            "progress": None,
            "failure_code": code,
            "failure_message": message,
        }
        for its in damaged:
            self._engine.overwrite(self._connection, tables.jobs, its, {**ended, **lost})
        mended = select(tables.jobs).where(number.in_(damaged))
        return self._readable(self._connection.execute(mended))

    def unfinished(self, tenant: TenantId, operation_ids: Collection[str]) -> frozenset[str]:
        """See `JobRepository`."""
        asked = {"its_tenant": tenant, "operations": list(operation_ids)}
        return frozenset(self._connection.execute(_unfinished(), asked).scalars())

    def exhausted(self, now_ms: int, *, hold: bool = False) -> list[JobRecord]:
        """See `LeasableJobs`."""
        return self._readable(self._connection.execute(_exhausted(hold), {"now_ms": now_ms}))

    def leased_to(self, owner: str | None) -> list[JobRecord]:
        """See `LeasableJobs`."""
        query = select(tables.jobs).where(tables.jobs.c.state == OperationState.RUNNING.value)
        if owner is not None:
            query = query.where(tables.jobs.c.lease_owner == owner)
        return self._readable(self._connection.execute(query.with_for_update()))

    def exchange(self, before: JobRecord, after: JobRecord) -> None:
        """See `LeasableJobs`: only what differs is written."""
        old, new = column_values(before), column_values(after)
        changes = {name: value for name, value in new.items() if value != old[name]}
        if changes:
            which = {"its_number": before.number, "its_tenant": before.tenant}
            self._connection.execute(changed_row(self._table), {**changes, **which})
        if self._on_change is not None:
            self._on_change(before, after)

    def forget_answers(self, before_ns: int, limit: int) -> int:
        """See `JobRepository`."""
        jobs = tables.jobs.c
        # The condition of the partial index, word for word: with a parameter in it the index is not used.
        ended = and_(text(tables.ANSWERED_QUERIES), jobs.finished_at_ns < before_ns)
        old = select(jobs.number).where(ended).order_by(jobs.finished_at_ns).limit(limit)
        return self._connection.execute(delete(tables.jobs).where(jobs.number.in_(old))).rowcount

    def waiting(self) -> Waiting:
        """See `JobRepository`."""
        jobs = tables.jobs.c
        queued, running = jobs.state == OperationState.QUEUED.value, jobs.state == OperationState.RUNNING.value
        oldest_ns: int | None = self._connection.execute(
            select(func.min(jobs.created_at_ns)).where(queued)
        ).scalar_one()
        lost = or_(and_(queued, jobs.attempts > 0), and_(running, jobs.attempts > 1))
        begun_again = select(func.count()).select_from(tables.jobs).where(lost)
        return Waiting(oldest_ns, int(self._connection.execute(begun_again).scalar_one()))


@cache
def _unfinished() -> Select[Any]:
    """The `operations` of `its_tenant` that wait or run."""
    jobs, operations = tables.jobs.c, BindParameter[Any]("operations", expanding=True)
    its = and_(jobs.tenant == bindparam("its_tenant"), jobs.operation_id.in_(operations), _unended())
    return select(jobs.operation_id).where(its)


def _unended() -> ColumnElement[bool]:
    return tables.jobs.c.state.in_((OperationState.QUEUED.value, OperationState.RUNNING.value))


@cache
def _runnable(lost: bool, hold: bool) -> Select[Any]:
    """The next queued job of a tenant, or the next with a `lost` lease. Takes `now_ms` and `tenant`.

    Where it is to be held, one that another transaction holds is passed over.
    """
    jobs = tables.jobs.c
    due = and_(jobs.state == OperationState.QUEUED.value, jobs.not_before_ms <= bindparam("now_ms"))
    ready = and_(_lost(), _counted() < jobs.max_attempts) if lost else due
    own = jobs.tenant == bindparam("tenant")
    first = select(tables.jobs).where(ready, own).order_by(jobs.priority, jobs.number).limit(1)
    return first.with_for_update(skip_locked=True) if hold else first


@cache
def _exhausted(hold: bool) -> Select[Any]:
    """The jobs with their last allowed lease lost. Takes `now_ms`."""
    spent = _counted() >= tables.jobs.c.max_attempts
    dead = select(tables.jobs).where(_lost(), spent)
    return dead.with_for_update(skip_locked=True) if hold else dead


def _counted() -> ColumnElement[int]:
    return tables.jobs.c.attempts - tables.jobs.c.forgiven


def _lost() -> ColumnElement[bool]:
    jobs = tables.jobs.c
    return and_(jobs.state == OperationState.RUNNING.value, jobs.lease_expires_ms <= bindparam("now_ms"))
