"""Checksums of rows in a SQLite file: written with every row, and compared where somebody looks for damage.

SQLite tells a damaged page only where its structure is wrong; a flipped bit of a number or a descriptor is another
number to it. So each table has a column `checksum`, of all its other columns. A writer's connection fills it in by
triggers that are its own (TEMP): no writer of a row can forget it, and the file needs no function of ours to be
opened by other programs. The schema itself has one, too: SQLite keeps a number for its user, `user_version`. The audit
log has a chain of hashes, and the counters of numbers are compared with the rows.
"""

from __future__ import annotations

import dataclasses
import json
import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from revisit.service.engines.sql.checksums import carried_checksum, counted_checksum, row_checksum
from revisit.service.features.audit.calls import judge
from revisit.service.ports.access import AuditRecord

COLUMN = "checksum"

ALONE = {"submaps": "descriptor"}
"""The column of a table that is checked by itself, wherever it is read."""

COUNTERS = "map_counters"
"""A damaged row of this table is changed by nobody: it would give numbers out again."""


def add_function(connection: sqlite3.Connection) -> None:
    """Make `row_checksum` known to a connection."""
    connection.create_function("row_checksum", -1, row_checksum, deterministic=True)


def keep_checksums(connection: sqlite3.Connection) -> None:
    """From now on every row that this connection writes gets its checksum, in every table that has a column for it."""
    add_function(connection)
    connection.create_function("carried_checksum", 4, carried_checksum, deterministic=True)
    connection.create_function("counted_checksum", 4, counted_checksum, deterministic=True)
    for table, columns in _tables(connection).items():
        old, new = (_of(row, columns) for row in ("OLD", "NEW"))
        alone = ALONE.get(table)
        kept = f'OLD."{alone}" IS NEW."{alone}"' if alone else "1"
        follows = "counted_checksum" if table == COUNTERS else "carried_checksum"
        carried = f"{follows}(OLD.{COLUMN}, row_checksum({old}), row_checksum({new}), {kept})"
        # The write of the first trigger is no change for the second.
        for event, when, value in (
            ("INSERT", "", f"row_checksum({new})"),
            ("UPDATE", f"WHEN NEW.{COLUMN} IS OLD.{COLUMN}", carried),
        ):
            update = f'UPDATE "{table}" SET {COLUMN} = {value} WHERE rowid = NEW.rowid'  # noqa: S608  # own schema
            name = f"checksum_{table}_{event}"
            connection.execute(
                f'CREATE TEMP TRIGGER "{name}" AFTER {event} ON main."{table}" {when} BEGIN {update}; END'
            )


def seal(connection: sqlite3.Connection, damaged: Sequence[DamagedRow] = ()) -> None:
    """Give every row and the schema their checksum, as they are: after the schema was changed.

    The checksums of `damaged` rows stay wrong.
    """
    add_function(connection)
    for table, columns in _tables(connection).items():
        sealed = f'UPDATE "{table}" SET {COLUMN} = row_checksum({_of(None, columns)})'  # noqa: S608
        _among_texts(connection, table, sealed, "1")
    for row in damaged:
        where = " AND ".join(f'"{column}" IS ?' for column in row.key)
        found = connection.execute(f'SELECT {COLUMN} FROM "{row.table}" WHERE {where}', [*row.key.values()]).fetchone()  # noqa: S608
        if found is not None:
            kept = carried_checksum(row.stored, row.computed, found[0], 1)
            connection.execute(f'UPDATE "{row.table}" SET {COLUMN} = ? WHERE {where}', [kept, *row.key.values()])  # noqa: S608
    connection.execute(f"PRAGMA user_version = {_schema_checksum(connection) if _tables(connection) else 0}")


@dataclass(frozen=True)
class DamagedRow:
    """A row whose checksum is wrong: its primary key, the checksum that is stored, and that of its values."""

    table: str
    key: dict[str, Any]
    stored: int
    computed: int


def damage(connection: sqlite3.Connection) -> list[DamagedRow]:
    """The damaged rows, to be handed to `seal`: but for those of the audit log, such as were never sealed, and such as
    have a damaged text, to which nobody gives a checksum.

    Raises sqlite3.Error.
    """
    add_function(connection)
    found = []
    for table, columns in _tables(connection).items():
        names = [row[1] for row in connection.execute(f'PRAGMA table_info("{table}")') if row[5]]
        key, computed = ", ".join(f'"{name}"' for name in names), f"row_checksum({_of(None, columns)})"
        told = f'SELECT {COLUMN}, {computed}, {key} FROM "{table}"'  # noqa: S608
        rows, _ = _among_texts(connection, table, told, f"{COLUMN} <> {computed}")
        found += [DamagedRow(table, dict(zip(names, its, strict=True)), *sums) for *sums, its in map(_split, rows)]
    return found


def _split(row: tuple[Any, ...]) -> tuple[Any, ...]:
    return row[0], row[1], row[2:]


def is_whole(table: str, row: Mapping[str, Any]) -> bool:
    """Whether the stored values of a row of a table, by column, fit its checksum; of a table without one they do."""
    if COLUMN not in row:
        return True
    computed = row_checksum(*(None if column is None else row[column] for column in _checked(table, row)))
    return bool(row[COLUMN] == computed)


def damaged_rows(connection: sqlite3.Connection) -> Iterator[str]:
    """The damaged rows, as "table number"; the schema and the counters of numbers, too.

    Nothing of a database from before there were checksums. Raises sqlite3.Error where the damage keeps it from being
    read.
    """
    add_function(connection)
    tables = _tables(connection)
    (kept,) = connection.execute("PRAGMA user_version").fetchone()
    if not tables and not kept:
        return
    if kept != _schema_checksum(connection):
        yield "the schema"
    for table, columns in tables.items():
        yield from _wrong_rows(connection, table, columns)
    yield from _wrong_counters(connection)
    yield from _wrong_audit(connection)


def _wrong_rows(connection: sqlite3.Connection, table: str, columns: Sequence[str | None]) -> Iterator[str]:
    right = f"row_checksum({_of(None, columns)})"
    numbers = f'SELECT rowid FROM "{table}"'  # noqa: S608  # own schema
    try:
        rows, without = _among_texts(connection, table, numbers, f"{COLUMN} IS NOT {right}")
        yield from (f"{table} {number}" for number in sorted([*without, *(number for (number,) in rows)]))
    except sqlite3.Error as error:
        yield f"{table}: {error}"


def _among_texts(
    connection: sqlite3.Connection, table: str, statement: str, where: str
) -> tuple[list[tuple[Any, ...]], tuple[int, ...]]:
    """The rows of a table that a statement gives `where` that holds, and the numbers of rows with a text that is none.

    No function can be given such a text, so that the statement is run without those rows. Raises sqlite3.Error.
    """
    try:
        return connection.execute(f"{statement} WHERE {where}").fetchall(), ()
    except sqlite3.Error:
        without = tuple(_without_text(connection, table))
        if not without:
            raise
        others = f"CASE WHEN rowid IN ({', '.join(map(str, without))}) THEN 0 ELSE {where} END"
        return connection.execute(f"{statement} WHERE {others}").fetchall(), without


def _without_text(connection: sqlite3.Connection, table: str) -> Iterator[int]:
    """The numbers of the rows of a table with a text that is none."""
    with any_text(connection):
        for number, *values in connection.execute(f'SELECT rowid, * FROM "{table}"'):  # noqa: S608  # own schema
            if any(isinstance(value, NoText) for value in values):
                yield number


class NoText(bytes):
    """Bytes of a text that are none."""


@contextmanager
def any_text(connection: sqlite3.Connection) -> Iterator[None]:
    """Within the block a text that is none is read as NoText, instead of ending the reading."""
    connection.text_factory = _text_or_none
    try:
        yield
    finally:
        connection.text_factory = str


def _text_or_none(data: bytes) -> str | NoText:
    try:
        return data.decode()
    except UnicodeDecodeError:
        return NoText(data)


def _wrong_audit(connection: sqlite3.Connection) -> Iterator[str]:
    """The breaks in the chain of the audit log; its last row must be the last that was ever written."""
    (highest,) = connection.execute("SELECT max(seq) FROM sqlite_sequence WHERE name = 'audit_log'").fetchone()
    try:
        fault = judge(_audit_rows(connection), highest or 0).fault
    except (sqlite3.Error, TypeError) as error:  # of a value that is of another kind now
        fault = str(error)
    if fault is not None:
        yield f"audit_log: {fault}"


def _audit_rows(connection: sqlite3.Connection) -> Iterator[AuditRecord]:
    names = [field.name for field in dataclasses.fields(AuditRecord)]
    rows = connection.execute(f"SELECT {', '.join(names)} FROM audit_log ORDER BY number")  # noqa: S608  # own schema
    for row in rows:
        fields = dict(zip(names, row, strict=True))
        try:
            yield AuditRecord(**{**fields, "detail": json.loads(fields["detail"])})
        except ValueError:
            yield AuditRecord(**{**fields, "hash": ""})


def _wrong_counters(connection: sqlite3.Connection) -> Iterator[str]:
    """Counters by which a number could be given out again."""
    counters = dict(connection.execute("SELECT name, seq FROM sqlite_sequence"))
    counted = connection.execute("SELECT name FROM sqlite_schema WHERE type = 'table' AND sql LIKE '%AUTOINCREMENT%'")
    known = {table for (table,) in counted}
    for table in sorted(known):
        (highest,) = connection.execute(f'SELECT max(rowid) FROM "{table}"').fetchone()  # noqa: S608  # own schema
        if highest is not None and not (isinstance(counters.get(table), int) and counters[table] >= highest):
            yield f"the counter of {table}"
    for name in sorted(map(str, counters.keys() - known)):
        yield f"a counter of {name!r}"


def _of(row: str | None, columns: Sequence[str | None]) -> str:
    """The arguments of `row_checksum` for the `columns` of OLD, of NEW, or of the row that is looked at."""
    prefix = "" if row is None else f"{row}."
    return ", ".join("NULL" if column is None else f'{prefix}"{column}"' for column in columns)


def _tables(connection: sqlite3.Connection) -> dict[str, list[str | None]]:
    """The tables with a column for checksums, and the columns that `row_checksum` takes: first the one that can be
    checked alone, if there is one.
    """
    found: dict[str, list[str | None]] = {}
    for (table,) in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'table' ORDER BY name").fetchall():
        columns = [row[1] for row in connection.execute(f'PRAGMA table_info("{table}")')]
        if COLUMN in columns:
            found[table] = _checked(table, columns)
    return found


def _checked(table: str, columns: Iterable[str]) -> list[str | None]:
    """The arguments of `row_checksum` by column."""
    alone = ALONE.get(table)
    return [alone, *(column for column in sorted(columns) if column not in (COLUMN, alone))]


def _schema_checksum(connection: sqlite3.Connection) -> int:
    """Checksum of the schema and its version: a signed number of 32 bits that is not 0."""
    parts = connection.execute("SELECT type, name, tbl_name, sql FROM sqlite_schema ORDER BY type, name").fetchall()
    versions = connection.execute("SELECT version_num FROM alembic_version").fetchall()
    return (zlib.crc32(ascii([parts, versions]).encode()) or 1) - 2**31
