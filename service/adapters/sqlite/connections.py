"""Connections to a SQLite file.

What makes them durable or harmless (pragmas), when their transactions begin, which process may write (the writers'
lock), and what SQLite's errors mean: no room, damaged, or uncertain until a restart.
"""

from __future__ import annotations

import fcntl
import os
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.exc import DatabaseError

from revisit.core.errors import DataLoss
from revisit.service.adapters.files.disk import FailStop
from revisit.service.adapters.files.durable_files import may_grow, open_lock, try_lock
from revisit.service.application.contract.errors import StorageFull, StorageUncertain

DATABASE = "revisit.db"
"""The name of the database file in the data folder."""

READERS = 2

WRITER_PRAGMAS: dict[str, str | int] = {
    "journal_mode": "wal",
    "synchronous": 2,  # FULL: a commit returns when it is on the disk
    "foreign_keys": 1,
    "busy_timeout": 5000,
    "journal_size_limit": 64 * 2**20,  # bytes: a checkpoint truncates a longer write-ahead log to this
    "temp_store": 2,  # MEMORY: a full disk cannot break a rollback
    "secure_delete": 1,  # deleted rows are overwritten
}
READER_PRAGMAS: dict[str, str | int] = {"query_only": 1, "busy_timeout": 5000, "wal_autocheckpoint": 0}

LOCK_TIMEOUT_S = 5.0

FULL = ("SQLITE_FULL", "SQLITE_IOERR_SHMSIZE")
"""No room: in a file, or for the index of the write-ahead log."""

WRITE_FAILED = "SQLITE_IOERR_WRITE"
"""A broken disk; or a quota, or the limit of a file's size, which SQLite does not tell apart."""

FRAME_BYTES = 4096 + 24
"""The least by which the write-ahead log grows."""

DAMAGED = ("SQLITE_CORRUPT", "SQLITE_NOTADB")


def writer_engine(path: Path, *, checkpoints: bool) -> Engine:
    """An engine of one connection whose transactions take the write lock at once and are on disk when they commit.

    `checkpoints`: after every 1000 pages a commit copies the write-ahead log back into the database.
    """
    engine = create_engine(f"sqlite:///{path}", pool_size=1, max_overflow=0)
    _prepare(engine, writer_pragmas(checkpoints=checkpoints), "BEGIN IMMEDIATE")
    return engine


def reader_engine(path: Path) -> Engine:
    """An engine whose transactions see one snapshot and can change nothing."""
    engine = create_engine(f"sqlite:///{path}", pool_size=READERS, max_overflow=0)
    _prepare(engine, READER_PRAGMAS, "BEGIN")
    return engine


def writer_pragmas(*, checkpoints: bool) -> dict[str, str | int]:
    """What a writer's connection must have."""
    return WRITER_PRAGMAS | {"wal_autocheckpoint": 1000 if checkpoints else 0}


def require_pragmas(engine: Engine, pragmas: dict[str, str | int]) -> None:
    """Raises RuntimeError where a connection is not as `pragmas` demand: SQLite ignores what it cannot grant."""
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


def write_ahead_log(database: Path) -> Path:
    """The file of what is committed and not checkpointed yet."""
    return database.with_name(f"{database.name}-wal")


def _prepare(engine: Engine, pragmas: dict[str, str | int], begin: str) -> None:
    @event.listens_for(engine, "connect")
    def set_pragmas(connection: Any, _record: Any) -> None:
        # The driver must not begin transactions by itself: it would do so only before a write.
        connection.isolation_level = None
        for name, value in pragmas.items():
            connection.execute(f"PRAGMA {name}={value}")

    @event.listens_for(engine, "begin")
    def begin_transaction(connection: Connection) -> None:
        connection.exec_driver_sql(begin)


class WriterLock:
    """A lock between processes that a writer holds for each transaction, its checkpoint included.

    SQLite's own lock lets one connection write while another checkpoints, which is how SQLite before 3.51.3 can damage
    its write-ahead log; and SQLite waits for it in ever longer sleeps. The kernel releases this lock when its process
    ends, however it ends. Waiting is fair: the first in line holds the turn lock, so a busy process cannot take the
    writer lock twice while another waits.
    """

    def __init__(self, database: Path) -> None:
        """The lock files lie beside `database`."""
        self._writer = open_lock(database.with_name(f"{database.name}.writer"))
        self._turn = open_lock(database.with_name(f"{database.name}.turn"))

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the lock. Raises StorageUncertain after 5 s, with nothing written."""
        deadline = time.monotonic() + LOCK_TIMEOUT_S
        with ExitStack() as holding:
            with _locked(self._turn, deadline):
                holding.enter_context(_locked(self._writer, deadline))
            yield

    def close(self) -> None:
        """Close the files."""
        os.close(self._writer)
        os.close(self._turn)


@contextmanager
def _locked(descriptor: int, deadline: float) -> Iterator[None]:
    """Hold one `flock`. Raises StorageUncertain at `deadline` of the monotonic clock."""
    while not try_lock(descriptor):
        if time.monotonic() > deadline:
            raise StorageUncertain("another process holds the database; nothing was stored")
        time.sleep(0.001)
    try:
        yield
    finally:
        fcntl.flock(descriptor, fcntl.LOCK_UN)


@dataclass(frozen=True)
class StorageFailures:
    """Turns SQLite's errors into those of the ports, and acts on them.

    `log` is the write-ahead log. The first I/O error trips `fail_stop`; `on_full` is called where there is no room.
    """

    log: Path
    fail_stop: FailStop
    on_full: Callable[[], None]

    @contextmanager
    def translated(self) -> Iterator[None]:
        """Raises StorageFull, DataLoss or StorageUncertain for an error of the database in the block."""
        try:
            yield
        except DatabaseError as error:
            raise self._translation(error) from error

    def _translation(self, error: DatabaseError) -> Exception:
        name = str(getattr(error.orig, "sqlite_errorname", ""))
        if name in FULL or (name == WRITE_FAILED and not may_grow(self.log, FRAME_BYTES)):
            self.on_full()
            return StorageFull()
        if name in DAMAGED:
            return DataLoss(f"the database is damaged: {error.orig}")
        if name.startswith("SQLITE_IOERR"):
            self.fail_stop.trip(f"{name}: {error.orig}")
        return StorageUncertain(f"the database failed: {error.orig}")
