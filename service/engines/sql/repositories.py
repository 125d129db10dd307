"""Repositories over one connection: records in and out. The tenant is in every statement that a use case can reach.

The statements that they share are built once, because building one takes as long as running it.
"""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from operator import itemgetter
from typing import Any, Generic, TypeVar

from sqlalchemy import (
    BigInteger,
    BindParameter,
    ColumnElement,
    Connection,
    CursorResult,
    Delete,
    Row,
    Select,
    Table,
    Text,
    TextClause,
    Update,
    and_,
    bindparam,
    cast,
    delete,
    func,
    insert,
    select,
    text,
    true,
    update,
)
from sqlalchemy.exc import IntegrityError
from sqlalchemy.sql.dml import ReturningInsert

from revisit.service.domain.errors import AlreadyExists, NotFound
from revisit.service.domain.events import ChangeOf
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import PlanRecord, ScanRecord, SubmapRecord
from revisit.service.domain.states import SubmapState
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.checksums import sound_descriptor
from revisit.service.engines.sql.engine import DatabaseEngine
from revisit.service.engines.sql.map_numbers import note_submap
from revisit.service.engines.sql.packed_columns import RowDamaged, of_kinds, read_stored, require_kinds, require_values
from revisit.service.engines.sql.presence import present
from revisit.service.ports.repositories import FoundSubmap, PathPoint, PlacedSubmap, SubmapStanding

Scalar = str | int | None
Asked = Mapping[str, Scalar]
"""The value that each named column must have; also the parameters of the statements that are built from it."""

R = TypeVar("R")

REVISED_AT_ONCE = 500
"""Rows that one statement changes: each is a parameter of it."""


class SqlRepository(Generic[R]):
    """`Repository` over a table with the fields of the record as columns."""

    def __init__(
        self,
        connection: Connection,
        engine: DatabaseEngine,
        table: Table,
        record: type[R],
        on_change: ChangeOf[R] | None = None,
        *,
        sees_all: bool = False,
    ) -> None:
        """`on_change` gets each add and replace; `sees_all`: also rows under deletion."""
        self._connection = connection
        self._engine = engine
        self._table = table
        self._record = record
        self._key: tuple[str, ...] = table.info["key"]
        self._on_change = on_change
        self._sees_all = sees_all

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
        added: R = dataclasses.replace(record, number=number)  # type: ignore[type-var]  # R is always a record dataclass
        if self._on_change is not None:
            self._on_change(None, added)
        return added

    def add_all(self, records: Sequence[R]) -> None:
        """See `Repository`."""
        rows = [column_values(record) for record in records]
        for row in rows:
            row.pop("number")
        try:
            if rows:
                self._connection.execute(insert(self._table), rows)
        except IntegrityError as error:
            if self._engine.is_duplicate(error):
                raise AlreadyExists from error
            raise NotFound("the parent of one of these resources does not exist") from error
        for record in records if self._on_change is not None else ():
            self._on_change(None, record)  # type: ignore[misc]  # the loop is empty without it

    def get(self, tenant: TenantId, *key: str | int, hold: bool = False) -> R | None:
        """See `Repository`."""
        asked = of_tenant(tenant, dict(zip(self._key, key, strict=True)))
        query = _held_row(self._table, self._sees_all, tuple(asked)) if hold else self._rows_where(asked)
        row = self._connection.execute(query, asked).one_or_none()
        return None if row is None else self._of(row)

    def find(self, tenant: TenantId, *, after: int = 0, limit: int | None = None, **equals: Scalar) -> list[R]:
        """See `Repository`."""
        return self._found(of_tenant(tenant, equals), after, limit)

    def numbered(self, tenant: TenantId, numbers: Sequence[int], *, hold: bool = False) -> dict[int, R]:
        """See `Repository`."""
        query = _numbered(self._table, self._sees_all, hold=hold)
        rows = self._connection.execute(query, {"numbers": numbers, "its_tenant": tenant})
        return {row.number: self._of(row) for row in rows}

    def distinct(self, tenant: TenantId, field: str, **equals: Scalar) -> set[Any]:
        """See `Repository`."""
        asked = of_tenant(tenant, equals)
        query = _distinct_where(self._table, self._sees_all, field, *_given_and_absent(asked))
        return set(self._connection.execute(query, asked).scalars())

    def count(self, tenant: TenantId, **equals: Scalar) -> int:
        """See `Repository`."""
        asked = of_tenant(tenant, equals)
        return int(self._connection.execute(self._count_where(asked), asked).scalar_one())

    def damaged(self, tenant: TenantId, **equals: Scalar) -> list[int]:
        """See `Repository`."""
        numbers = sorted(self.distinct(tenant, "number", **equals))
        return self._engine.damaged_rows(self._connection, self._table, numbers)

    def count_of_all_tenants(self, **equals: Scalar) -> int:
        """See `Repository`."""
        return int(self._connection.execute(self._count_where(equals), equals).scalar_one())

    def of_all_tenants(self, *, after: int = 0, limit: int | None = None) -> list[R]:
        """See `Repository`."""
        try:
            with self._engine.any_text(self._connection):
                return self._found({}, after, limit)
        except RowDamaged:
            return self._sound(after, limit)

    def replace(self, record: R) -> None:
        """See `Repository`."""
        row = column_values(record)
        before = None if self._on_change is None else self.numbered(row["tenant"], [row["number"]]).get(row["number"])
        which = {"its_number": row.pop("number"), "its_tenant": row.pop("tenant")}
        if self._connection.execute(changed_row(self._table), {**row, **which}).rowcount != 1:
            raise NotFound
        if self._on_change is not None:
            self._on_change(before, record)

    def replace_all(self, records: Sequence[R]) -> None:
        """See `Repository`."""
        rows = [column_values(record) for record in records]
        for row in rows:
            row["its_number"], row["its_tenant"] = row.pop("number"), row.pop("tenant")
        if rows and self._connection.execute(changed_row(self._table), rows).rowcount != len(rows):
            raise NotFound

    def revise(self, records: Sequence[R], **fields: Scalar) -> None:
        """See `Repository`."""
        which = [column_values(record) for record in records]
        for start in range(0, len(which), REVISED_AT_ONCE):
            some = which[start : start + REVISED_AT_ONCE]
            which_rows = {"numbers": [row["number"] for row in some], "its_tenant": some[0]["tenant"]}
            if self._connection.execute(_revised(self._table), {**fields, **which_rows}).rowcount != len(some):
                raise NotFound
        if self._on_change is not None:
            for record in records:
                self._on_change(record, dataclasses.replace(record, **fields))  # type: ignore[type-var]  # as in `add`

    def delete(self, tenant: TenantId, **equals: Scalar) -> int:
        """See `Repository`."""
        asked = of_tenant(tenant, equals)
        return self._connection.execute(delete(self._table).where(matches(self._table, asked)), asked).rowcount

    def some(self, tenant: TenantId, limit: int, **equals: Scalar) -> list[R]:
        """See `Repository`."""
        asked = of_tenant(tenant, equals)
        query = self._rows_where(asked).limit(bindparam("at_most"))
        return [self._of(row) for row in self._connection.execute(query, {**asked, "at_most": limit})]

    def delete_some(self, tenant: TenantId, limit: int, field: str, values: Sequence[Scalar]) -> int:
        """See `Repository`."""
        asked = {"its_tenant": tenant, "at_most": limit, "its_values": values}
        all_of_them = field == "number" and len(values) <= limit
        statement = _numbered_deleted(self._table) if all_of_them else _some_deleted(self._table, field)
        return self._connection.execute(statement, asked).rowcount

    def _rows_where(self, asked: Asked) -> Select[Any]:
        """The rows that match."""
        return _rows_where(self._table, self._sees_all, *_given_and_absent(asked))

    def _count_where(self, asked: Asked) -> Select[int]:
        """The number of rows that match."""
        return _count_where(self._table, self._sees_all, *_given_and_absent(asked))

    def _where(self, asked: Asked) -> ColumnElement[bool]:
        """Whether a row matches and is visible."""
        return and_(matches(self._table, asked), seen(self._table, self._sees_all))

    def _found(self, asked: Asked, after: int, limit: int | None) -> list[R]:
        query = _rows_after(self._table, self._sees_all, *_given_and_absent(asked), limited=limit is not None)
        rows = self._connection.execute(query, {**asked, "after_number": after, "at_most": limit})
        return [self._of(row) for row in rows]

    def _sound(self, after: int, limit: int | None) -> list[R]:
        """The rows of all tenants but for damaged ones; none only where none follow."""
        query = _rows_after(self._table, self._sees_all, (), (), limited=limit is not None)
        found: list[R] = []
        numbers: Sequence[int] = [after]
        while numbers and not found:
            asked = {"after_number": numbers[-1], "at_most": limit}
            numbers = self._connection.execute(query.with_only_columns(self._table.c.number), asked).scalars().all()
            found = self._readable(self._connection.execute(query, asked))
        return found

    def _readable(self, rows: CursorResult[Any]) -> list[R]:
        """The records but for damaged ones."""
        return [record for record in self._each(rows) if record is not None]

    def _each(self, rows: CursorResult[Any]) -> Iterator[R | None]:
        """The record of each row; None for a damaged one."""
        while True:
            try:
                with self._engine.any_text(self._connection):
                    row = rows.fetchone()
                record = None if row is None else self._of(row)
            except RowDamaged:
                yield None
                continue
            if record is None:
                return
            yield record

    def _of(self, row: Row[Any]) -> R:
        require_kinds(self._table, row)
        fields = _in_order_of_fields(self._table, self._record)  # type: ignore[arg-type]  # classes are hashable
        return self._record(*fields(row))


class SqlScans(SqlRepository[ScanRecord]):
    """`ScanRepository`."""

    def first_seq_from(self, tenant: TenantId, map_id: str, session_id: str, travelled_m: float) -> int | None:
        """See `ScanRepository`."""
        asked = of_tenant(tenant, {"map_id": map_id, "session_id": session_id})
        query = _first_seq_from(self._sees_all, tuple(asked))
        first: int | None = self._connection.execute(query, {**asked, "from_m": travelled_m}).scalar_one()
        return first

    def chosen_between(
        self, tenant: TenantId, map_id: str, session_id: str, first: int, last: int, newest: int | None = None
    ) -> list[ScanRecord]:
        """See `ScanRepository`."""
        asked = of_tenant(tenant, {"map_id": map_id, "session_id": session_id})
        query = _chosen_between(self._sees_all, tuple(asked), limited=newest is not None)
        rows = self._connection.execute(query, {**asked, "first": first, "last": last, "at_most": newest})
        return [self._of(row) for row in rows][::-1]

    def around(self, tenant: TenantId, map_id: str, session_id: str, stamp_ns: int, limit: int) -> list[ScanRecord]:
        """See `ScanRepository`. Times rise with the numbers, which have an index: a search by halves."""
        scans, asked = tables.scans.c, of_tenant(tenant, {"map_id": map_id, "session_id": session_id})
        times = select(scans.seq, scans.stamp_ns).where(self._where(asked)).limit(1)
        ends = [self._connection.execute(times.order_by(one), asked).first() for one in (scans.seq, scans.seq.desc())]
        first, last = (0 if end is None else end.seq for end in ends)
        behind = times.where(scans.seq >= bindparam("middle")).order_by(scans.seq)
        while first < last:
            middle = (first + last + 1) // 2
            row = self._connection.execute(behind, {**asked, "middle": middle}).one()
            if row.stamp_ns <= stamp_ns:
                first = row.seq
            else:
                last = middle - 1
        query = self._rows_where(asked).where(scans.seq >= first).order_by(scans.seq).limit(limit)
        return [self._of(row) for row in self._connection.execute(query, asked)]

    def points_of(self, tenant: TenantId) -> int:
        """See `ScanRepository`."""
        scans = tables.scans.c
        query = select(func.coalesce(func.sum(scans.point_count), 0)).where(scans.tenant == tenant)
        return int(self._connection.execute(query).scalar_one())

    def with_seqs(self, tenant: TenantId, map_id: str, session_id: str, seqs: Sequence[int]) -> list[ScanRecord]:
        """See `ScanRepository`."""
        seq, asked = tables.scans.c.seq, of_tenant(tenant, {"map_id": map_id, "session_id": session_id})
        rows = self._connection.execute(self._rows_where(asked).where(seq.in_(seqs)).order_by(seq), asked)
        return [self._of(row) for row in rows]


class SqlPlans(SqlRepository[PlanRecord]):
    """`PlanRepository`."""

    def bytes_of(self, tenant: TenantId) -> int:
        """See `PlanRepository`."""
        plans = tables.plans.c
        query = select(func.coalesce(func.sum(plans.size_bytes), 0)).where(plans.tenant == tenant)
        return int(self._connection.execute(query).scalar_one())


class SqlSubmaps(SqlRepository[SubmapRecord]):
    """`SubmapRepository`."""

    def add(self, record: SubmapRecord) -> SubmapRecord:
        """See `Repository`; its `seq` is given at the end of the transaction."""
        added = super().add(record)
        note_submap(self._connection, TenantId(added.tenant), added.map_id, added.number)
        return added

    def _of(self, row: Row[Any]) -> SubmapRecord:
        """A submap without its descriptor where that is damaged."""
        record = super()._of(row)
        descriptor = sound_descriptor(record.number, record.descriptor, row.checksum)
        return record if descriptor is record.descriptor else dataclasses.replace(record, descriptor=descriptor)

    def last_seq(self, tenant: TenantId, map_id: str) -> int:
        """See `SubmapRepository`."""
        asked = of_tenant(tenant, {"map_id": map_id})
        last = self._connection.execute(_last_seq(), asked).scalar() or 0
        require_values([tables.map_counters.c.submaps], [last])
        return int(last)

    def points_of(self, tenant: TenantId) -> int:
        """See `SubmapRepository`."""
        submaps = tables.submaps.c
        posted = and_(submaps.tenant == tenant, submaps.cloud_sha256.is_not(None))
        query = select(func.coalesce(func.sum(submaps.point_count), 0)).where(posted)
        return int(self._connection.execute(query).scalar_one())

    def placed(self, tenant: TenantId, map_id: str, after: int = 0) -> list[PlacedSubmap]:
        """See `SubmapRepository`."""
        asked = of_tenant(tenant, {"map_id": map_id})
        query = _placed(self._sees_all, tuple(asked))
        return [PlacedSubmap(*row) for row in self._connection.execute(query, {**asked, "after_seq": after})]

    def found(self, tenant: TenantId, numbers: Sequence[int]) -> dict[int, FoundSubmap]:
        """See `SubmapRepository`."""
        rows = self._connection.execute(_found_submaps(self._sees_all), {"numbers": numbers, "its_tenant": tenant})
        return {row.number: FoundSubmap(*row) for row in rows}

    def path(
        self, tenant: TenantId, map_id: str, session_id: str, ordinal: int, limit: int, *, back: bool = False
    ) -> list[PathPoint]:
        """See `SubmapRepository`."""
        asked = of_tenant(tenant, {"map_id": map_id, "session_id": session_id})
        rows = self._connection.execute(
            _path(self._sees_all, back=back), {**asked, "from_ordinal": ordinal, "at_most": limit}
        )
        return [PathPoint(*row) for row in rows]

    def standings(self, tenant: TenantId, map_id: str, session_id: str | None = None) -> list[SubmapStanding]:
        """See `SubmapRepository`."""
        asked = of_tenant(tenant, {"map_id": map_id} | ({} if session_id is None else {"session_id": session_id}))
        columns = [tables.submaps.c[field.name] for field in dataclasses.fields(SubmapStanding)]
        query = select(*columns).where(self._where(asked)).order_by(tables.submaps.c.number)
        return [SubmapStanding(*row) for row in of_kinds(columns, self._connection.execute(query, asked))]

    def first_waiting(self, tenant: TenantId, map_id: str) -> int | None:
        """See `SubmapRepository`."""
        return self._first(of_tenant(tenant, {"state": SubmapState.QUEUED.value, "map_id": map_id}))

    def first_unsearched(self, tenant: TenantId, map_id: str) -> int | None:
        """See `SubmapRepository`."""
        # The condition of the partial index, word for word.
        return self._first(of_tenant(tenant, {"map_id": map_id}), text(tables.UNSEARCHED))

    def _first(self, asked: Asked, *further: TextClause) -> int | None:
        query = select(func.min(tables.submaps.c.seq)).where(self._where(asked), *further)
        first: int | None = self._connection.execute(query, asked).scalar_one()
        return first

    def flag_counts(self, tenant: TenantId, map_id: str, session_id: str) -> dict[str, int]:
        """See `SubmapRepository`."""
        submaps = tables.submaps.c
        asked = of_tenant(tenant, {"map_id": map_id, "session_id": session_id})
        flags_text = cast(submaps.flags, Text)  # JSON has no order in which to group
        kinds = select(flags_text, submaps.failure_code, func.count()).where(self._where(asked))
        counts: Counter[str] = Counter()
        for flags, failure, count in self._connection.execute(kinds.group_by(flags_text, submaps.failure_code), asked):
            counts.update(dict.fromkeys((*read_stored(_names, flags), *(() if failure is None else (failure,))), count))
        return dict(counts)


def _names(text: str) -> tuple[str, ...]:
    return tuple(json.loads(text))


def of_tenant(tenant: TenantId, equals: Asked) -> dict[str, Scalar]:
    """`equals` within the rows of one tenant: no row of another is ever looked at."""
    return {"tenant": tenant, **equals}


def column_values(record: Any) -> dict[str, Any]:
    """The fields of a record by column, not copied deeply: JSON fields stay as they are."""
    return {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}


@cache
def new_row(table: Table) -> ReturningInsert[Any]:
    """A new row; gives its primary key."""
    return insert(table).returning(*table.primary_key.columns)


@cache
def changed_row(table: Table) -> Update:
    """Overwrites the row of number `its_number` of tenant `its_tenant`."""
    return update(table).where(table.c.number == bindparam("its_number"), table.c.tenant == bindparam("its_tenant"))


def _given_and_absent(asked: Asked) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The columns that must equal the parameter of their name, and those that must be null."""
    given = tuple(name for name, value in asked.items() if value is not None)
    return given, tuple(name for name, value in asked.items() if value is None)


@cache
def _distinct_where(
    table: Table, sees_all: bool, field: str, given: tuple[str, ...], absent: tuple[str, ...]
) -> Select[Any]:
    """Each value of a column that is not null, once."""
    column = table.c[field]
    return select(column).where(_has(table, given, absent), seen(table, sees_all), column.is_not(None)).distinct()


@cache
def _numbered(table: Table, sees_all: bool, *, hold: bool) -> Select[Any]:
    rows = select(table).where(_have_numbers(table), seen(table, sees_all))
    return rows.order_by(table.c.number).with_for_update(key_share=True) if hold else rows


@cache
def _revised(table: Table) -> Update:
    """Sets the columns that are given of the rows with one of the `numbers`."""
    return update(table).where(_have_numbers(table))


@cache
def _first_seq_from(sees_all: bool, given: tuple[str, ...]) -> Select[Any]:
    """Takes `from_m`."""
    scans = tables.scans
    from_m = scans.c.travelled_m >= bindparam("from_m")
    return select(func.min(scans.c.seq)).where(_has(scans, given, ()), seen(scans, sees_all), from_m)


@cache
def _chosen_between(sees_all: bool, given: tuple[str, ...], *, limited: bool) -> Select[Any]:
    """From `first` to `last`, the newest first; `at_most` so many of them where `limited`."""
    scans = tables.scans.c
    within = and_(scans.chosen, scans.seq >= bindparam("first"), scans.seq <= bindparam("last"))
    rows = _rows_where(tables.scans, sees_all, given, ()).where(within).order_by(scans.seq.desc())
    return rows.limit(bindparam("at_most")) if limited else rows


@cache
def _last_seq() -> Select[Any]:
    counters = tables.map_counters
    return select(counters.c.submaps).where(_has(counters, ("tenant", "map_id"), ()))


@cache
def _placed(sees_all: bool, given: tuple[str, ...]) -> Select[Any]:
    """The columns of PlacedSubmap of submaps with a `seq` above `after_seq`, by session and the order of the drive."""
    submaps = tables.submaps.c
    query = select(*(submaps[field.name] for field in dataclasses.fields(PlacedSubmap)))
    query = query.where(_has(tables.submaps, given, ()), seen(tables.submaps, sees_all))
    return query.where(submaps.seq > bindparam("after_seq")).order_by(submaps.session_number, submaps.ordinal)


@cache
def _found_submaps(sees_all: bool) -> Select[Any]:
    columns = (tables.submaps.c[field.name] for field in dataclasses.fields(FoundSubmap))
    return select(*columns).where(_have_numbers(tables.submaps), seen(tables.submaps, sees_all))


@cache
def _path(sees_all: bool, *, back: bool) -> Select[Any]:
    """The rows of `SubmapRepository.path` for a session from `from_ordinal` on, or back."""
    submaps = tables.submaps.c
    query = select(*(submaps[field.name] for field in dataclasses.fields(PathPoint)))
    query = query.where(_has(tables.submaps, ("tenant", "map_id", "session_id"), ()), seen(tables.submaps, sees_all))
    start = bindparam("from_ordinal", type_=BigInteger)
    ahead = submaps.ordinal < start if back else submaps.ordinal > start
    order = submaps.ordinal.desc() if back else submaps.ordinal
    return query.where(ahead).order_by(order).limit(bindparam("at_most"))


def _have_numbers(table: Table) -> ColumnElement[bool]:
    """The rows of tenant `its_tenant` with one of the `numbers`.

    The tenant is made an expression, which no index holds: else the engine looks through all rows of the tenant, where
    a few are asked for by their numbers.
    """
    numbers: BindParameter[Any] = bindparam("numbers", expanding=True)
    return and_(table.c.number.in_(numbers), table.c.tenant.concat("") == bindparam("its_tenant"))


@cache
def _rows_where(table: Table, sees_all: bool, given: tuple[str, ...], absent: tuple[str, ...]) -> Select[Any]:
    return select(table).where(_has(table, given, absent), seen(table, sees_all))


@cache
def _held_row(table: Table, sees_all: bool, key: tuple[str, ...]) -> Select[Any]:
    """The row of a key, locked until the transaction ends: rows that refer to it may still be added."""
    return _rows_where(table, sees_all, key, ()).with_for_update(key_share=True)


@cache
def _rows_after(
    table: Table, sees_all: bool, given: tuple[str, ...], absent: tuple[str, ...], *, limited: bool
) -> Select[Any]:
    """The rows numbered above `after_number`, in their order; `at_most` so many of them where `limited`."""
    number = table.c.number
    rows = _rows_where(table, sees_all, given, absent).where(number > bindparam("after_number")).order_by(number)
    return rows.limit(bindparam("at_most")) if limited else rows


@cache
def _in_order_of_fields(table: Table, record: type) -> Callable[[Row[Any]], tuple[Any, ...]]:
    """A getter that brings the columns of a row into the order of the record's fields."""
    columns = list(table.columns.keys())
    return itemgetter(*(columns.index(field.name) for field in dataclasses.fields(record)))


@cache
def _count_where(table: Table, sees_all: bool, given: tuple[str, ...], absent: tuple[str, ...]) -> Select[int]:
    return select(func.count()).select_from(table).where(_has(table, given, absent), seen(table, sees_all))


@cache
def _numbered_deleted(table: Table) -> Delete:
    """Deletes the rows of tenant `its_tenant` with these numbers, `its_values`: no more than they are, so by their key
    alone. A server would join them with all rows of a table that is not large.
    """
    numbers: BindParameter[Any] = bindparam("its_values", expanding=True)
    return delete(table).where(table.c.number.in_(numbers), table.c.tenant.concat("") == bindparam("its_tenant"))


@cache
def _some_deleted(table: Table, field: str) -> Delete:
    """Deletes at most `at_most` rows of tenant `its_tenant` with one of `its_values` in `field`."""
    values: BindParameter[Any] = bindparam("its_values", expanding=True)
    own = table.c.tenant.concat("") == bindparam("its_tenant")
    some = select(table.c.number).where(table.c[field].in_(values), own).limit(bindparam("at_most"))
    return delete(table).where(table.c.number.in_(some))


def seen(table: Table, sees_all: bool) -> ColumnElement[bool]:
    """Condition of visible rows: none for readers of everything."""
    return true() if sees_all else present(table)


def matches(table: Table, asked: Asked) -> ColumnElement[bool]:
    """Condition of the rows that match."""
    return _has(table, *_given_and_absent(asked))


def _has(table: Table, given: tuple[str, ...], absent: tuple[str, ...]) -> ColumnElement[bool]:
    equal = (table.c[name] == bindparam(name) for name in given)
    return and_(true(), *equal, *(table.c[name].is_(None) for name in absent))
