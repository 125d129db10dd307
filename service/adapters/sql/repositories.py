"""Repositories over one connection: records in and out. The tenant is in every statement that a use case can reach."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from typing import Any, Generic, TypeVar

from sqlalchemy import Connection, Row, Table, and_, delete, func, select
from sqlalchemy.exc import IntegrityError

from revisit.service.adapters.sql import tables
from revisit.service.adapters.sql.engine import DatabaseEngine
from revisit.service.adapters.sql.statements import (
    Asked,
    Scalar,
    changed_row,
    column_values,
    count_where,
    matches,
    new_row,
    of_tenant,
    rows_where,
)
from revisit.service.application.contract.errors import AlreadyExists, NotFound
from revisit.service.application.contract.identity import TenantId
from revisit.service.application.contract.records import ScanRecord, SubmapRecord
from revisit.service.application.contract.states import SubmapState

R = TypeVar("R")


class SqlRepository(Generic[R]):
    """`Repository` over a table whose columns are the fields of the record."""

    def __init__(
        self, connection: Connection, engine: DatabaseEngine, table: Table, record: type[R], key: tuple[str, ...]
    ) -> None:
        """`key` names the columns that, with the tenant, identify a record."""
        self._connection = connection
        self._engine = engine
        self._table = table
        self._record = record
        self._key = key

    def add(self, record: R) -> R:
        """See `Repository`."""
        row = column_values(record)
        row.pop("number")
        try:
            number = int(self._connection.execute(new_row(self._table), row).scalar_one())
        except IntegrityError as error:
            if self._engine.is_duplicate(error):
                raise AlreadyExists from error
            raise NotFound("the parent of this resource does not exist") from error
        return dataclasses.replace(record, number=number)  # type: ignore[type-var]  # R is always a record dataclass

    def get(self, tenant: TenantId, *key: str | int) -> R | None:
        """See `Repository`."""
        asked = of_tenant(tenant, dict(zip(self._key, key, strict=True)))
        row = self._connection.execute(rows_where(self._table, asked), asked).one_or_none()
        return None if row is None else self._of(row)

    def find(self, tenant: TenantId, *, after: int = 0, limit: int | None = None, **equals: Scalar) -> list[R]:
        """See `Repository`."""
        return self._found(of_tenant(tenant, equals), after, limit)

    def numbered(self, tenant: TenantId, numbers: Sequence[int]) -> dict[int, R]:
        """See `Repository`."""
        where = and_(self._table.c.number.in_(numbers), self._table.c.tenant == tenant)
        rows = self._connection.execute(select(self._table).where(where))
        return {row.number: self._of(row) for row in rows}

    def distinct(self, tenant: TenantId, field: str, **equals: Scalar) -> set[Any]:
        """See `Repository`."""
        column, asked = self._table.c[field], of_tenant(tenant, equals)
        query = select(column).where(matches(self._table, asked), column.is_not(None)).distinct()
        return set(self._connection.execute(query, asked).scalars())

    def count(self, tenant: TenantId, **equals: Scalar) -> int:
        """See `Repository`."""
        asked = of_tenant(tenant, equals)
        return int(self._connection.execute(count_where(self._table, asked), asked).scalar_one())

    def count_of_all_tenants(self, **equals: Scalar) -> int:
        """See `Repository`."""
        return int(self._connection.execute(count_where(self._table, equals), equals).scalar_one())

    def of_all_tenants(self, *, after: int = 0, limit: int | None = None) -> list[R]:
        """See `Repository`."""
        return self._found({}, after, limit)

    def replace(self, record: R) -> None:
        """See `Repository`."""
        row = column_values(record)
        which = {"its_number": row.pop("number"), "its_tenant": row.pop("tenant")}
        if self._connection.execute(changed_row(self._table), {**row, **which}).rowcount != 1:
            raise NotFound

    def delete(self, tenant: TenantId, **equals: Scalar) -> int:
        """See `Repository`."""
        asked = of_tenant(tenant, equals)
        return self._connection.execute(delete(self._table).where(matches(self._table, asked)), asked).rowcount

    def _found(self, asked: Asked, after: int, limit: int | None) -> list[R]:
        number = self._table.c.number
        query = rows_where(self._table, asked).where(number > after).order_by(number).limit(limit)
        return [self._of(row) for row in self._connection.execute(query, asked)]

    def _of(self, row: Row[Any]) -> R:
        return self._record(**row._mapping)


class SqlScans(SqlRepository[ScanRecord]):
    """`ScanRepository`."""

    def first_seq_from(self, tenant: TenantId, map_id: str, session_id: str, travelled_m: float) -> int | None:
        """See `ScanRepository`."""
        asked = of_tenant(tenant, {"map_id": map_id, "session_id": session_id})
        where = and_(matches(tables.scans, asked), tables.scans.c.travelled_m >= travelled_m)
        query = select(func.min(tables.scans.c.seq)).where(where)
        first: int | None = self._connection.execute(query, asked).scalar_one()
        return first

    def points_of(self, tenant: TenantId) -> int:
        """See `ScanRepository`."""
        scans = tables.scans.c
        query = select(func.coalesce(func.sum(scans.point_count), 0)).where(scans.tenant == tenant)
        return int(self._connection.execute(query).scalar_one())

    def with_seqs(self, tenant: TenantId, map_id: str, session_id: str, seqs: Sequence[int]) -> list[ScanRecord]:
        """See `ScanRepository`."""
        seq, asked = tables.scans.c.seq, of_tenant(tenant, {"map_id": map_id, "session_id": session_id})
        rows = self._connection.execute(rows_where(tables.scans, asked).where(seq.in_(seqs)).order_by(seq), asked)
        return [self._of(row) for row in rows]


class SqlSubmaps(SqlRepository[SubmapRecord]):
    """`SubmapRepository`."""

    def last_number(self) -> int:
        """See `SubmapRepository`."""
        return self._engine.last_number(self._connection, tables.submaps)

    def points_of(self, tenant: TenantId) -> int:
        """See `SubmapRepository`."""
        submaps = tables.submaps.c
        posted = and_(submaps.tenant == tenant, submaps.cloud_sha256.is_not(None))
        query = select(func.coalesce(func.sum(submaps.point_count), 0)).where(posted)
        return int(self._connection.execute(query).scalar_one())

    def waiting_up_to(self, tenant: TenantId, map_id: str, number: int) -> int:
        """See `SubmapRepository`."""
        asked = of_tenant(tenant, {"state": SubmapState.QUEUED.value, "map_id": map_id})
        query = count_where(tables.submaps, asked).where(tables.submaps.c.number <= number)
        return int(self._connection.execute(query, asked).scalar_one())

    def flag_counts(self, tenant: TenantId, map_id: str, session_id: str) -> dict[str, int]:
        """See `SubmapRepository`."""
        submaps = tables.submaps.c
        asked = of_tenant(tenant, {"map_id": map_id, "session_id": session_id})
        kinds = select(submaps.flags, submaps.failure_code, func.count()).where(matches(tables.submaps, asked))
        counts: Counter[str] = Counter()
        for flags, failure, count in self._connection.execute(
            kinds.group_by(submaps.flags, submaps.failure_code), asked
        ):
            counts.update(dict.fromkeys((*flags, *(() if failure is None else (failure,))), count))
        return dict(counts)
