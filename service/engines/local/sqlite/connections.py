"""Opening a SQLite file: pragmas for durable or read-only connections, and the beginning of transactions."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

from pydantic_core import from_json
from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.pool import NullPool

from revisit.service.engines.local.sqlite.row_checksums import keep_checksums

DATABASE = "revisit.db"
"""The name of the database file in the data folder."""

READERS = 2
"""Threads that read for the event loop. Other threads read for themselves, each with a connection of its own."""

WRITER_PRAGMAS: dict[str, str | int] = {
    "journal_mode": "wal",
    "synchronous": 2,  # FULL: a commit returns when it is on the disk
    "foreign_keys": 1,
    "busy_timeout": 5000,
    "journal_size_limit": 64 * 2**20,  # bytes: a checkpoint truncates a longer write-ahead log to this
    "temp_store": 2,  # MEMORY: a full disk cannot break a rollback
    "secure_delete": 1,  # deleted rows are overwritten
}
INCREMENTAL = 2
"""The `auto_vacuum` of a file that can give pages back. A file that has tables keeps its own, so nothing demands it."""

READER_PRAGMAS: dict[str, str | int] = {"query_only": 1, "busy_timeout": 5000, "wal_autocheckpoint": 0}


def writer_engine(path: Path, *, checkpoints: bool, checksums: bool = True) -> Engine:
    """An engine of one connection: its transactions take the write lock at once and are on disk when they commit.

    `checkpoints`: after every 1000 pages a commit copies the write-ahead log back into the database. Every row that is
    written gets its checksum, unless the schema itself is to be changed (`checksums`).
    """
    engine = create_engine(f"sqlite:///{path}", json_deserializer=from_json, pool_size=1, max_overflow=0)
    pragmas = {"auto_vacuum": INCREMENTAL, **writer_pragmas(checkpoints=checkpoints)}
    _prepare(engine, pragmas, "BEGIN IMMEDIATE", keep_checksums if checksums else None)
    return engine


def reader_engine(path: Path) -> Engine:
    """An engine for reading: its transactions see one snapshot and can change nothing."""
    engine = create_engine(f"sqlite:///{path}", json_deserializer=from_json, poolclass=NullPool)
    _prepare(engine, READER_PRAGMAS, "BEGIN")
    return engine


def writer_pragmas(*, checkpoints: bool) -> dict[str, str | int]:
    """Required pragmas of a writer's connection."""
    return WRITER_PRAGMAS | {"wal_autocheckpoint": 4000 if checkpoints else 0}


def require_pragmas(engine: Engine, pragmas: dict[str, str | int]) -> None:
    """Raises RuntimeError where a connection is not as `pragmas` demand: SQLite ignores values that it cannot grant."""
    with engine.connect() as connection:
        granted = {name: connection.exec_driver_sql(f"PRAGMA {name}").scalar() for name in pragmas}
    wrong = {name: value for name, value in granted.items() if value != pragmas[name]}
    if wrong:
        raise RuntimeError(f"the database connection has {wrong}, not { ({name: pragmas[name] for name in wrong}) }")


def open_to_read(database: Path, *, at_rest: bool = False) -> sqlite3.Connection:
    """A connection that cannot write, beside the service or without it; `at_rest`: nobody else has the file open.

    Raises sqlite3.Error.
    """
    options = "mode=ro&immutable=1" if at_rest else "mode=ro"
    return sqlite3.connect(f"{database.absolute().as_uri()}?{options}", uri=True, timeout=5.0)


class DataVersion:
    """Whether anything was committed to a database, asked of SQLite's own counter on a connection that never writes."""

    def __init__(self, database: Path) -> None:
        """Opened beside the running service. Raises sqlite3.Error."""
        self._connection = sqlite3.connect(
            database, isolation_level=None, timeout=0.0, check_same_thread=False, cached_statements=1
        )
        self._connection.execute("PRAGMA query_only=1")
        self._asking = threading.Lock()

    def now(self) -> int | None:
        """A number that is another one after a commit of any other connection; None where it cannot be had at once."""
        try:
            # All of it, so that the statement ends, and with it the snapshot that it reads.
            with self._asking:
                return int(self._connection.execute("PRAGMA data_version").fetchall()[0][0])
        except sqlite3.Error:
            return None

    def close(self) -> None:
        """Close the connection; from here on the number is not known."""
        self._connection.close()


def unreadable(database: Path) -> str:
    """The damage of the database file; "" where it can be read, does not exist yet or is busy."""
    if not database.exists():
        return ""
    try:
        with closing(open_to_read(database)) as connection:
            connection.execute("SELECT version_num FROM alembic_version").fetchone()
    except sqlite3.DatabaseError as error:
        broken = database.is_dir() or error.sqlite_errorcode in (sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT)
        return str(error) if broken else ""
    return ""


def write_ahead_log(database: Path) -> Path:
    """The write-ahead log: commits that are not checkpointed yet."""
    return database.with_name(f"{database.name}-wal")


def _prepare(
    engine: Engine,
    pragmas: dict[str, str | int],
    begin: str,
    afterwards: Callable[[sqlite3.Connection], None] | None = None,
) -> None:
    @event.listens_for(engine, "connect")
    def set_pragmas(connection: Any, _record: Any) -> None:
        # The driver must not begin transactions by itself: it would do so only before a write.
        connection.isolation_level = None
        for name, value in pragmas.items():
            connection.execute(f"PRAGMA {name}={value}")
        if afterwards is not None:
            afterwards(connection)

    event.listen(engine, "begin", partial(Connection.exec_driver_sql, statement=begin))
