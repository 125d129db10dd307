"""Jobs in an SQL database: the next to run, those with an expired lease, those long finished."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from typing import Any

from sqlalchemy import ColumnElement, Select, and_, bindparam, delete, func, or_, select, text

from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord
from revisit.service.domain.states import OperationState
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.repositories import SqlRepository
from revisit.service.ports.clock import Instant
from revisit.service.ports.repositories import Waiting


class SqlJobs(SqlRepository[JobRecord]):
    """`JobRepository`."""

    def next_runnable(self, now: Instant, tenant: TenantId) -> JobRecord | None:
        """See `LeasableJobs`."""
        asked = {**_moment(now), "tenant": tenant}
        # One query per state: each walks the index of its state, however many jobs have finished.
        rows = [self._connection.execute(_runnable(lost), asked).first() for lost in (False, True)]
        first = [self._of(row) for row in rows if row is not None]
        return min(first, key=lambda job: (job.priority, job.number), default=None)

    def unfinished(self, tenant: TenantId, operation_ids: Collection[str]) -> frozenset[str]:
        """See `JobRepository`."""
        jobs = tables.jobs.c
        going_on = jobs.state.in_((OperationState.QUEUED.value, OperationState.RUNNING.value))
        its = and_(jobs.tenant == tenant, jobs.operation_id.in_(operation_ids), going_on)
        return frozenset(self._connection.execute(select(jobs.operation_id).where(its)).scalars())

    def exhausted(self, now: Instant) -> list[JobRecord]:
        """See `LeasableJobs`."""
        return [self._of(row) for row in self._connection.execute(_exhausted(), _moment(now))]

    def leased_to(self, owner: str | None) -> list[JobRecord]:
        """See `LeasableJobs`."""
        query = select(tables.jobs).where(tables.jobs.c.state == OperationState.RUNNING.value)
        if owner is not None:
            query = query.where(tables.jobs.c.lease_owner == owner)
        return [self._of(row) for row in self._connection.execute(query)]

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
def _runnable(lost: bool) -> Select[Any]:
    """The next queued job of a tenant, or the next with a `lost` lease. Takes `_moment` and `tenant`."""
    jobs = tables.jobs.c
    due = or_(jobs.lease_epoch != bindparam("epoch"), jobs.not_before_ms <= bindparam("now_ms"))
    ready = (
        and_(_lost(), _counted() < jobs.max_attempts) if lost else and_(jobs.state == OperationState.QUEUED.value, due)
    )
    own = jobs.tenant == bindparam("tenant")
    return select(tables.jobs).where(ready, own).order_by(jobs.priority, jobs.number).limit(1)


@cache
def _exhausted() -> Select[Any]:
    """The jobs with their last allowed lease lost. Takes `_moment`."""
    return select(tables.jobs).where(_lost(), _counted() >= tables.jobs.c.max_attempts)


def _counted() -> ColumnElement[int]:
    return tables.jobs.c.attempts - tables.jobs.c.forgiven


def _lost() -> ColumnElement[bool]:
    jobs = tables.jobs.c
    expired = or_(jobs.lease_epoch != bindparam("epoch"), jobs.lease_expires_ms <= bindparam("now_ms"))
    return and_(jobs.state == OperationState.RUNNING.value, expired)


def _moment(now: Instant) -> dict[str, Any]:
    return {"epoch": now.epoch, "now_ms": now.ms}
