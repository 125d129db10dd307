"""Repositories over one connection: SQL in, records out. The tenant is in every statement that a use case can reach."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from typing import Any, Generic, TypeVar

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    Select,
    Table,
    Update,
    and_,
    bindparam,
    delete,
    func,
    insert,
    or_,
    select,
    text,
    true,
    update,
)
from sqlalchemy.exc import IntegrityError
from sqlalchemy.sql.dml import ReturningInsert

from revisit.service.adapters.sql import tables
from revisit.service.application.contract.errors import AlreadyExists, NotFound
from revisit.service.application.contract.identity import TenantId
from revisit.service.application.contract.ports import IndexChange, Instant
from revisit.service.application.contract.records import JobRecord, ScanRecord, SubmapRecord, WorkerRecord

R = TypeVar("R")

Scalar = str | int | None


class SqlRepository(Generic[R]):
    """`ports.Repository` over a table whose columns are the fields of the record."""

    def __init__(self, connection: Connection, table: Table, record: type[R], key: tuple[str, ...]) -> None:
        """`key` names the columns that, with the tenant, identify a record."""
        self._connection = connection
        self._table = table
        self._record = record
        self._key = key

    def add(self, record: R) -> R:
        """See `ports.Repository`."""
        values = _values(record)
        values.pop("number")
        try:
            number = _insert(self._connection, self._table, values)
        except IntegrityError as error:
            if "UNIQUE" in str(error.orig):
                raise AlreadyExists from error
            raise NotFound("the parent of this resource does not exist") from error
        return dataclasses.replace(record, number=number)  # type: ignore[type-var]  # R is always a record dataclass

    def get(self, tenant: TenantId, *key: str | int) -> R | None:
        """See `ports.Repository`."""
        asked = _of_tenant(tenant, dict(zip(self._key, key, strict=True)))
        row = self._connection.execute(_finding(self._table, *_columns(asked)), asked).one_or_none()
        return None if row is None else self._of(row)

    def find(self, tenant: TenantId, *, after: int = 0, limit: int | None = None, **equals: Scalar) -> list[R]:
        """See `ports.Repository`."""
        return self._found(_of_tenant(tenant, equals), after, limit)

    def numbered(self, tenant: TenantId, numbers: Sequence[int]) -> dict[int, R]:
        """See `ports.Repository`."""
        where = and_(self._table.c.number.in_(numbers), self._table.c.tenant == tenant)
        rows = self._connection.execute(select(self._table).where(where))
        return {row.number: self._of(row) for row in rows}

    def distinct(self, tenant: TenantId, field: str, **equals: Scalar) -> set[Any]:
        """See `ports.Repository`."""
        column, asked = self._table.c[field], _of_tenant(tenant, equals)
        query = select(column).where(_equal(self._table, *_columns(asked)), column.is_not(None)).distinct()
        return set(self._connection.execute(query, asked).scalars())

    def count(self, tenant: TenantId, **equals: Scalar) -> int:
        """See `ports.Repository`."""
        asked = _of_tenant(tenant, equals)
        return int(self._connection.execute(_counting(self._table, *_columns(asked)), asked).scalar_one())

    def count_of_all_tenants(self, **equals: Scalar) -> int:
        """See `ports.Repository`."""
        return int(self._connection.execute(_counting(self._table, *_columns(equals)), equals).scalar_one())

    def of_all_tenants(self, *, after: int = 0, limit: int | None = None) -> list[R]:
        """See `ports.Repository`."""
        return self._found({}, after, limit)

    def replace(self, record: R) -> None:
        """See `ports.Repository`."""
        values = _values(record)
        row = {"its_number": values.pop("number"), "its_tenant": values.pop("tenant")}
        if self._connection.execute(_replacing(self._table), {**values, **row}).rowcount != 1:
            raise NotFound

    def delete(self, tenant: TenantId, **equals: Scalar) -> int:
        """See `ports.Repository`."""
        asked = _of_tenant(tenant, equals)
        statement = delete(self._table).where(_equal(self._table, *_columns(asked)))
        return self._connection.execute(statement, asked).rowcount

    def _found(self, asked: dict[str, Scalar], after: int, limit: int | None) -> list[R]:
        number = self._table.c.number
        query = _finding(self._table, *_columns(asked)).where(number > after).order_by(number).limit(limit)
        return [self._of(row) for row in self._connection.execute(query, asked)]

    def _of(self, row: Row[Any]) -> R:
        return self._record(**row._mapping)


class SqlScans(SqlRepository[ScanRecord]):
    """`ports.ScanRepository`."""

    def first_seq_from(self, tenant: TenantId, map_id: str, session_id: str, travelled_m: float) -> int | None:
        """See `ports.ScanRepository`."""
        asked = _of_tenant(tenant, {"map_id": map_id, "session_id": session_id})
        where = and_(_equal(tables.scans, *_columns(asked)), tables.scans.c.travelled_m >= travelled_m)
        query = select(func.min(tables.scans.c.seq)).where(where)
        first: int | None = self._connection.execute(query, asked).scalar_one()
        return first

    def with_seqs(self, tenant: TenantId, map_id: str, session_id: str, seqs: Sequence[int]) -> list[ScanRecord]:
        """See `ports.ScanRepository`."""
        seq, asked = tables.scans.c.seq, _of_tenant(tenant, {"map_id": map_id, "session_id": session_id})
        query = _finding(tables.scans, *_columns(asked)).where(seq.in_(seqs)).order_by(seq)
        rows = self._connection.execute(query, asked)
        return [self._of(row) for row in rows]


class SqlSubmaps(SqlRepository[SubmapRecord]):
    """`ports.SubmapRepository`."""

    def last_number(self) -> int:
        """See `ports.SubmapRepository`."""
        # SQLite's own record of AUTOINCREMENT, which outlives the rows.
        query = text("SELECT seq FROM sqlite_sequence WHERE name = 'submaps'")
        return int(self._connection.execute(query).scalar() or 0)

    def waiting_up_to(self, tenant: TenantId, map_id: str, number: int) -> int:
        """See `ports.SubmapRepository`."""
        asked = _of_tenant(tenant, {"state": "QUEUED", "map_id": map_id})
        query = _counting(tables.submaps, *_columns(asked)).where(tables.submaps.c.number <= number)
        return int(self._connection.execute(query, asked).scalar_one())


class SqlJobs(SqlRepository[JobRecord]):
    """`ports.JobRepository`."""

    def next_runnable(self, now: Instant, after: str = "") -> JobRecord | None:
        """See `ports.JobRepository`."""
        moment = {**_moment(now), "after": after}
        # One query per state: each walks the index of its state, whatever number of jobs have ended.
        for before in (False, True):
            rows = [self._connection.execute(_runnable(lost, before), moment).first() for lost in (False, True)]
            if first := [self._of(row) for row in rows if row is not None]:
                return min(first, key=lambda job: (job.tenant, job.priority, job.number))
        return None

    def exhausted(self, now: Instant) -> list[JobRecord]:
        """See `ports.JobRepository`."""
        return [self._of(row) for row in self._connection.execute(_exhausted(), _moment(now))]

    def leased_to(self, owner: str) -> list[JobRecord]:
        """See `ports.JobRepository`."""
        query = select(tables.jobs).where(tables.jobs.c.state == "RUNNING", tables.jobs.c.lease_owner == owner)
        return [self._of(row) for row in self._connection.execute(query)]

    def forget_answers(self, before_ns: int, limit: int) -> int:
        """See `ports.JobRepository`."""
        jobs = tables.jobs.c
        ended = and_(text("priority = 0"), jobs.finished_at_ns < before_ns)  # as the index has it, not a parameter
        old = select(jobs.number).where(ended).order_by(jobs.finished_at_ns).limit(limit)
        return self._connection.execute(delete(tables.jobs).where(jobs.number.in_(old))).rowcount

    def oldest_queued_ns(self) -> int | None:
        """See `ports.JobRepository`."""
        query = select(func.min(tables.jobs.c.created_at_ns)).where(tables.jobs.c.state == "QUEUED")
        oldest: int | None = self._connection.execute(query).scalar_one()
        return oldest


class SqlChangeLog:
    """`ports.ChangeLog`. SQLite gives out `seq` inside the one write transaction, hence in the order of commits."""

    def __init__(self, connection: Connection) -> None:
        """All statements go through `connection`."""
        self._connection = connection

    def record_described(self, tenant: TenantId, map_number: int, submap_number: int) -> int:
        """See `ports.ChangeLog`."""
        return _insert(
            self._connection, tables.index_changes, _change_row(tenant, map_number, submap_number, "DESCRIBED")
        )

    def record_removed(self, tenant: TenantId, map_number: int, submap_numbers: Collection[int]) -> None:
        """See `ports.ChangeLog`."""
        rows = [_change_row(tenant, map_number, number, "REMOVED") for number in sorted(submap_numbers)]
        if rows:
            self._connection.execute(insert(tables.index_changes), rows)

    def since(self, tenant: TenantId, map_number: int, seq: int, limit: int | None = None) -> list[IndexChange]:
        """See `ports.ChangeLog`."""
        asked = {"its_tenant": tenant, "its_map": map_number, "after": seq}
        return [_change(row) for row in self._connection.execute(_changes_since().limit(limit), asked)]


class SqlWorkerLog:
    """`ports.WorkerLog`."""

    def __init__(self, connection: Connection) -> None:
        """All statements go through `connection`."""
        self._connection = connection

    def beat(self, worker: WorkerRecord) -> None:
        """See `ports.WorkerLog`."""
        self.forget(worker.worker_id)
        self._connection.execute(insert(tables.workers).values(_values(worker)))

    def alive(self, epoch: str, since_ms: int) -> list[WorkerRecord]:
        """See `ports.WorkerLog`."""
        workers = tables.workers.c
        query = select(tables.workers).where(workers.epoch == epoch, workers.seen_ms >= since_ms)
        rows = self._connection.execute(query.order_by(workers.seen_ms.desc(), workers.worker_id))
        return [WorkerRecord(**row._mapping) for row in rows]

    def forget(self, worker_id: str) -> None:
        """See `ports.WorkerLog`."""
        self._connection.execute(delete(tables.workers).where(tables.workers.c.worker_id == worker_id))


def _values(record: Any) -> dict[str, Any]:
    """The fields of a record, shallow: JSON fields stay as they are."""
    return {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}


def _insert(connection: Connection, table: Table, values: dict[str, Any]) -> int:
    """Insert a row; the number it was given."""
    return int(connection.execute(_inserting(table), values).scalar_one())


def _of_tenant(tenant: TenantId, equals: Mapping[str, Scalar]) -> dict[str, Scalar]:
    """What the columns of a row must equal; no row of another tenant is ever looked at."""
    return {"tenant": tenant, **equals}


def _columns(asked: Mapping[str, Scalar]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The columns that are asked for: those that must equal a parameter of their name, and those that must be null."""
    given = tuple(name for name, value in asked.items() if value is not None)
    return given, tuple(name for name, value in asked.items() if value is None)


# Statements are put together once: that takes as long as running them.


@cache
def _finding(table: Table, given: tuple[str, ...], absent: tuple[str, ...]) -> Select[Any]:
    return select(table).where(_equal(table, given, absent))


@cache
def _counting(table: Table, given: tuple[str, ...], absent: tuple[str, ...]) -> Select[int]:
    return select(func.count()).select_from(table).where(_equal(table, given, absent))


@cache
def _inserting(table: Table) -> ReturningInsert[Any]:
    return insert(table).returning(*table.primary_key.columns)


@cache
def _replacing(table: Table) -> Update:
    return update(table).where(table.c.number == bindparam("its_number"), table.c.tenant == bindparam("its_tenant"))


@cache
def _runnable(lost: bool, before: bool) -> Select[Any]:
    """The next job that waits, or is `lost`, of the tenants that come after another one, or of it and those `before`.

    Takes `_moment` and `after`.
    """
    jobs = tables.jobs.c
    again = or_(jobs.lease_epoch != bindparam("epoch"), jobs.not_before_ms <= bindparam("now_ms"))
    ready = and_(_lost(), jobs.attempts < jobs.max_attempts) if lost else and_(jobs.state == "QUEUED", again)
    turn = jobs.tenant <= bindparam("after") if before else jobs.tenant > bindparam("after")
    return select(tables.jobs).where(ready, turn).order_by(jobs.tenant, jobs.priority, jobs.number).limit(1)


@cache
def _exhausted() -> Select[Any]:
    """The jobs that are lost for the last time. Takes `_moment`."""
    return select(tables.jobs).where(_lost(), tables.jobs.c.attempts >= tables.jobs.c.max_attempts)


def _lost() -> ColumnElement[bool]:
    jobs = tables.jobs.c
    expired = or_(jobs.lease_epoch != bindparam("epoch"), jobs.lease_expires_ms <= bindparam("now_ms"))
    return and_(jobs.state == "RUNNING", expired)


def _moment(now: Instant) -> dict[str, Any]:
    return {"epoch": now.epoch, "now_ms": now.ms}


@cache
def _changes_since() -> Select[Any]:
    """Takes `its_tenant`, `its_map` and `after`."""
    changes, submaps = tables.index_changes.c, tables.submaps.c
    return (
        select(changes.seq, changes.kind, changes.submap_number, submaps.session_number, submaps.ordinal)
        .add_columns(submaps.position_m, submaps.descriptor)
        .outerjoin_from(tables.index_changes, tables.submaps, submaps.number == changes.submap_number)
        .where(changes.tenant == bindparam("its_tenant"), changes.map_number == bindparam("its_map"))
        .where(changes.seq > bindparam("after"))
        .order_by(changes.seq)
    )


def _equal(table: Table, given: tuple[str, ...], absent: tuple[str, ...]) -> ColumnElement[bool]:
    equal = (table.c[name] == bindparam(name) for name in given)
    return and_(true(), *equal, *(table.c[name].is_(None) for name in absent))


def _change_row(tenant: TenantId, map_number: int, submap_number: int, kind: str) -> dict[str, Any]:
    return {"tenant": tenant, "map_number": map_number, "submap_number": submap_number, "kind": kind}


def _change(row: Row[Any]) -> IndexChange:
    gone = row.session_number is None
    return IndexChange(
        seq=row.seq,
        submap_number=row.submap_number,
        session_number=0 if gone else row.session_number,
        ordinal=0 if gone else row.ordinal,
        position_m=(0.0, 0.0, 0.0) if gone else row.position_m,
        vector=None if gone or row.kind == "REMOVED" else row.descriptor,
    )
