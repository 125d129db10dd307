"""The statements that the repositories share. Each is built once: building takes as long as running it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cache
from typing import Any

from sqlalchemy import ColumnElement, Select, Table, Update, and_, bindparam, func, insert, select, true, update
from sqlalchemy.sql.dml import ReturningInsert

from revisit.service.application.contract.identity import TenantId

Scalar = str | int | None
Asked = Mapping[str, Scalar]
"""The value that each named column must have; also the parameters of the statements that are built from it."""


def of_tenant(tenant: TenantId, equals: Asked) -> dict[str, Scalar]:
    """`equals` within the rows of one tenant: no row of another is ever looked at."""
    return {"tenant": tenant, **equals}


def column_values(record: Any) -> dict[str, Any]:
    """The fields of a record by column, not copied deeply: JSON fields stay as they are."""
    return {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}


def rows_where(table: Table, asked: Asked) -> Select[Any]:
    """The rows that have what is asked."""
    return _rows_where(table, *_given_and_absent(asked))


def count_where(table: Table, asked: Asked) -> Select[int]:
    """How many rows have what is asked."""
    return _count_where(table, *_given_and_absent(asked))


def matches(table: Table, asked: Asked) -> ColumnElement[bool]:
    """Whether a row has what is asked."""
    return _matches(table, *_given_and_absent(asked))


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
def _rows_where(table: Table, given: tuple[str, ...], absent: tuple[str, ...]) -> Select[Any]:
    return select(table).where(_matches(table, given, absent))


@cache
def _count_where(table: Table, given: tuple[str, ...], absent: tuple[str, ...]) -> Select[int]:
    return select(func.count()).select_from(table).where(_matches(table, given, absent))


def _matches(table: Table, given: tuple[str, ...], absent: tuple[str, ...]) -> ColumnElement[bool]:
    equal = (table.c[name] == bindparam(name) for name in given)
    return and_(true(), *equal, *(table.c[name].is_(None) for name in absent))
