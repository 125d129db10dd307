"""Moving an installation to another engine: every row as it is, every blob by its hash, and the proof that all came.

A move that was broken off goes on where it ended: rows of a table come in the order of their numbers, in portions that
are each a transaction, and a blob that is there already is not sent again. Whatever a process tells of itself stays
behind (workers, turns, processes); a job that ran begins anew, since times of leases are those of one store's clock.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from sqlalchemy import (
    Column,
    Connection,
    Engine,
    Integer,
    RowMapping,
    Table,
    func,
    insert,
    select,
    text,
    tuple_,
    update,
)

from revisit.service.domain.identity import TenantId
from revisit.service.domain.states import OperationState
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.blob_addresses import blob_addresses
from revisit.service.ports.blobs import BlobStore

PORTION = 500
"""Rows of a transaction."""

OF_PROCESSES = frozenset({"workers", "worker_turns", "tenant_turns", "processes"})
"""Tables that tell of processes, which are others in the new place."""

CHECKSUM = "checksum"
"""The column that an engine keeps for itself."""

Key: TypeAlias = tuple[Any, ...]

Progress = Callable[[str, int], None]
"""What has come: the name of a table, or "blobs", and the number of rows or blobs that were moved just now."""


class MoveRefused(ValueError):
    """The move cannot begin, or what came is not what was sent."""


@dataclass(frozen=True)
class Moved:
    """What is in the new place: rows by table, blobs, and a hash of all rows in the order of their keys."""

    rows: Mapping[str, int]
    blobs: int
    sha256: str


def moved_tables() -> list[Table]:
    """The tables that move, parents first."""
    return [table for table in tables.metadata.sorted_tables if table.name not in OF_PROCESSES]


def require_empty(target: Engine) -> None:
    """Raises MoveRefused where there are rows already."""
    with target.begin() as connection:
        filled = [table.name for table in moved_tables() if connection.execute(select(table).limit(1)).first()]
    if filled:
        raise MoveRefused(f"the target has rows already, in {', '.join(filled)}")


def move_rows(source: Engine, target: Engine, progress: Progress) -> None:
    """Copy the rows that the target lacks. Nobody else writes to either meanwhile."""
    for table in moved_tables():
        for portion in _portions(source, table, _reached(target, table)):
            with target.begin() as writing:
                writing.execute(insert(table), [_by_key(table, row) for row in portion])
            progress(table.name, len(portion))
    with source.begin() as reading, target.begin() as writing:
        _keep_numbers(reading, writing)
        _begin_jobs_anew(writing)


def move_blobs(rows: Engine, source: BlobStore, target: BlobStore, progress: Progress) -> int:
    """Copy the blobs that rows refer to and the target lacks, each checked against its hash; how many there are.

    Raises DataLoss for one that is lost or damaged, StorageFull, StorageUncertain.
    """
    with rows.begin() as connection:
        addresses = connection.execute(blob_addresses()).all()
    for tenant, kind, sha256 in addresses:
        if not target.exists(TenantId(tenant), kind, sha256):
            target.put(TenantId(tenant), kind, source.get(TenantId(tenant), kind, sha256))
        progress("blobs", 1)
    return len(addresses)


def digest(engine: Engine) -> tuple[dict[str, int], str]:
    """Rows by table and a hash of them all, the same on every engine; what a store's clock says is left out."""
    counts, whole = {}, hashlib.sha256()
    for table in moved_tables():
        counts[table.name] = 0
        for portion in _portions(engine, table, None):
            for row in portion:
                whole.update(json.dumps([table.name, *_compared(row)], default=_as_json).encode())
            counts[table.name] += len(portion)
    return counts, whole.hexdigest()


def _portions(engine: Engine, table: Table, after: Key | None) -> Iterator[list[RowMapping]]:
    """The rows of a table behind key `after`, in the order of its key; each portion is a transaction of its own."""
    key = _key(table)
    columns = [column for column in table.columns if column.name != CHECKSUM]
    while True:
        query = select(*columns).order_by(*key).limit(PORTION)
        with engine.begin() as connection:
            rows = connection.execute(query if after is None else query.where(tuple_(*key) > tuple_(*after))).all()
        if not rows:
            return
        yield [row._mapping for row in rows]
        after = tuple(rows[-1]._mapping[column.name] for column in key)


def _by_key(table: Table, row: RowMapping) -> dict[str, Any]:
    """The values of a row under the keys of its columns, which are not always their names in the database."""
    return {column.key: row[column.name] for column in table.columns if column.name != CHECKSUM}


def _key(table: Table) -> list[Column[Any]]:
    return list(table.primary_key.columns)


def _reached(target: Engine, table: Table) -> Key | None:
    """The highest key that came already."""
    key = _key(table)
    with target.begin() as connection:
        last = connection.execute(select(*key).order_by(*(column.desc() for column in key)).limit(1)).first()
    return None if last is None else tuple(last)


def _compared(row: RowMapping) -> list[Any]:
    """Its values, with those left out that the move changes; a job that ran waits again."""
    running, queued = OperationState.RUNNING.value, OperationState.QUEUED.value
    of_job = "lease_owner" in row
    return [
        queued if of_job and name == "state" and value == running else value
        for name, value in row.items()
        if name not in BY_CLOCK
    ]


def _as_json(value: Any) -> Any:
    """Bytes in a row: descriptors, packed columns."""
    if isinstance(value, bytes | memoryview):
        return hashlib.sha256(value).hexdigest()
    raise TypeError(f"{type(value)} in a row")


_LAST_VALUE = text("SELECT last_value FROM pg_sequences WHERE schemaname || '.' || sequencename = :name")

LEASED = {"lease_owner": None, "lease_id": "", "claimed_ms": 0, "not_before_ms": 0, "lease_expires_ms": 0}
"""What a lease keeps in the row of a job, by the store's clock, and what a job without one has there."""


BY_CLOCK = {*LEASED, "since_ms"}
"""Columns that a store's own clock, and the end of all leases, make others in the new place."""


def _begin_jobs_anew(connection: Connection) -> None:
    jobs = tables.jobs
    to_do = jobs.c.state.in_((OperationState.RUNNING.value, OperationState.QUEUED.value))
    freed = {name: value for name, value in LEASED.items() if name in jobs.c}
    connection.execute(update(jobs).where(to_do).values(state=OperationState.QUEUED.value, **freed))
    connection.execute(update(tables.unreferenced_blobs).values(since_ms=0))


def _keep_numbers(source: Connection, target: Connection) -> None:
    """Numbers that were given out once are given to no other row, though theirs may be gone."""
    for table in moved_tables():
        (key, *further) = _key(table)
        if further or not isinstance(key.type, Integer) or not key.autoincrement:
            continue
        last = _given(source, table)
        if last:
            _give_from(target, table, last)


def _given(connection: Connection, table: Table) -> int:
    if connection.dialect.name == "sqlite":
        query = text("SELECT seq FROM sqlite_sequence WHERE name = :table")
        return int(connection.execute(query, {"table": table.name}).scalar() or 0)
    (key,) = _key(table)
    sequence = connection.execute(select(func.pg_get_serial_sequence(table.name, key.name))).scalar()
    named = text("SELECT last_value FROM pg_sequences WHERE schemaname || '.' || sequencename = :name")
    given = connection.execute(named, {"name": sequence}).scalar()
    return max(int(given or 0), int(connection.execute(select(func.max(key))).scalar() or 0))


def _give_from(connection: Connection, table: Table, last: int) -> None:
    if connection.dialect.name == "sqlite":
        row = {"table": table.name, "last": last}
        known = connection.execute(text("UPDATE sqlite_sequence SET seq = :last WHERE name = :table"), row)
        if not known.rowcount:
            connection.execute(text("INSERT INTO sqlite_sequence (name, seq) VALUES (:table, :last)"), row)
        return
    (key,) = _key(table)
    sequence = select(func.setval(func.pg_get_serial_sequence(table.name, key.name), last))
    connection.execute(sequence)
