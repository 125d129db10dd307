"""Transactions on SQLite: one writer thread per process, snapshots for readers, durable commits.

Why it looks like this (measured, docs/decisions/0033): Python's driver begins no transaction before a SELECT, so
read-modify-write loses updates; with synchronous=NORMAL a power cut loses acknowledged rows of the write-ahead log;
SQLite before 3.51.3 can damage the log when two connections write or checkpoint at the same instant.

A writer's lock between processes is held for each transaction. SQLite's errors are given their meaning here: no room,
damaged, or uncertain until a restart.

Group commit: writes that wait while another is synced to disk share the next transaction and its one fsync.
"""

from __future__ import annotations

import fcntl
import os
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from sqlalchemy import Connection
from sqlalchemy.exc import DatabaseError

from revisit.core.errors import DataLoss
from revisit.service.domain.errors import StorageFull, StorageUncertain
from revisit.service.engines.group_commit import GroupCommitter
from revisit.service.engines.local.clock import MachineClock, SystemClock
from revisit.service.engines.local.files.disk import FailStop, may_grow, open_lock, try_lock
from revisit.service.engines.local.sqlite.bookkeeping import mend_bookkeeping
from revisit.service.engines.local.sqlite.connections import (
    READER_PRAGMAS,
    READERS,
    DataVersion,
    reader_engine,
    require_pragmas,
    write_ahead_log,
    writer_engine,
    writer_pragmas,
)
from revisit.service.engines.local.sqlite.engine import SqliteEngine
from revisit.service.engines.local.sqlite.store_clock import StoreClock
from revisit.service.engines.sql.map_numbers import noted, numbered
from revisit.service.engines.sql.unit_of_work import SqlUnitOfWork
from revisit.service.failpoints import failpoint
from revisit.service.ports.transactions import UnitOfWork

T = TypeVar("T")

LOCK_TIMEOUT_S = 5.0

FULL = ("SQLITE_FULL", "SQLITE_IOERR_SHMSIZE")
"""No room: in a file, or for the index of the write-ahead log."""

WRITE_FAILED = "SQLITE_IOERR_WRITE"
"""A broken disk; or a quota, or the limit of a file's size, which SQLite does not tell apart."""

FRAME_BYTES = 4096 + 24
"""The least by which the write-ahead log grows."""

DAMAGED = ("SQLITE_CORRUPT", "SQLITE_NOTADB")

NO_TEXT = "Could not decode to UTF-8"
NO_ARGUMENT = "user-defined function raised exception"
"""How the driver says that a text is none: it gives such an error no name."""


class SqliteTransactions:
    """`Transactions` on a SQLite file that `migrate` has prepared."""

    def __init__(
        self,
        path: Path,
        *,
        checkpoints: bool,
        lease_ms: int = 10_000,
        clock: MachineClock | None = None,
        fail_stop: FailStop | None = None,
        on_full: Callable[[], None] = lambda: None,
    ) -> None:
        """`checkpoints`: this process copies the write-ahead log into the database (one process does: the gateway).

        `fail_stop` is tripped by the first I/O error of the database, `on_full` called where the disk has no room.
        Raises RuntimeError where the connections are not as durable, or as harmless, as they must be.
        """
        self._writer = writer_engine(path, checkpoints=checkpoints)
        self._reader = reader_engine(path)
        self._version = DataVersion(path)
        self._idle: deque[Connection] = deque()
        self._closed = False
        require_pragmas(self._writer, writer_pragmas(checkpoints=checkpoints))
        require_pragmas(self._reader, READER_PRAGMAS)
        self._clock = clock or SystemClock()
        self._store_clock = StoreClock(self._clock)
        self._engine = SqliteEngine(self._store_clock)
        self._lock = WriterLock(path)
        self._lease_ms = lease_ms
        self._fail_stop = fail_stop or FailStop()
        self._failures = StorageFailures(write_ahead_log(path), self._fail_stop, on_full)
        self._writing = GroupCommitter(self._transaction, mend=self._mend)
        self._reading = ThreadPoolExecutor(READERS, thread_name_prefix="reader")

    def write(self, work: Callable[[UnitOfWork], T], *, durable: bool = True) -> Future[T]:
        """See `Transactions`; every commit is durable."""
        return self._writing.submit(partial(self._noted, work=work))

    def read(self, work: Callable[[UnitOfWork], T]) -> Future[T]:
        """See `Transactions`."""
        return self._reading.submit(self.read_here, work)

    def read_here(self, work: Callable[[UnitOfWork], T]) -> T:
        """See `Transactions`."""
        with self._failures.translated(), self._to_read() as connection, connection.begin(), _cursors_closed():
            return work(self._unit_of_work(connection))

    def version(self) -> int | None:
        """See `Transactions`."""
        return self._version.now()

    def close(self) -> None:
        """See `Transactions`."""
        self._version.close()
        self._writing.close()
        self._reading.shutdown(wait=True)
        self._closed = True
        while self._idle:
            self._idle.pop().close()
        self._reader.dispose()
        self._writer.dispose()
        self._lock.close()

    @contextmanager
    def _transaction(self) -> Iterator[Connection]:
        self._fail_stop.require_sound()
        with self._failures.translated(), self._lock.held():
            with self._writer.begin() as connection:
                self._store_clock.begin(connection)
                with numbered(connection):
                    yield connection
                failpoint("commit.before")
            failpoint("commit.after")

    def _mend(self) -> None:
        with self._failures.translated(), self._lock.held(), self._writer.begin() as connection:
            mend_bookkeeping(connection)

    @contextmanager
    def _to_read(self) -> Iterator[Connection]:
        """A connection that nobody else has meanwhile. It stays open for the next read, unless the database failed."""
        try:
            connection = self._idle.pop()
        except IndexError:
            connection = self._reader.connect()
        sound = True
        try:
            yield connection
        except DatabaseError:
            sound = False
            raise
        finally:
            if sound and not self._closed:
                self._idle.append(connection)
            else:
                connection.close()

    def _noted(self, connection: Connection, work: Callable[[UnitOfWork], T]) -> T:
        with _cursors_closed():
            return noted(connection, lambda: work(self._unit_of_work(connection)))

    def _unit_of_work(self, connection: Connection) -> UnitOfWork:
        return SqlUnitOfWork(connection, self._engine, self._lease_ms, self._clock)


@contextmanager
def _cursors_closed() -> Iterator[None]:
    """Work that an error ends among its rows leaves no cursor: a snapshot stays open as long as one of its readers.

    The frames of the error would hold it, for as long as anybody holds the error.
    """
    try:
        yield
    except Exception as error:
        traceback.clear_frames(error.__traceback__)
        raise


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
        if name in DAMAGED or (not name and str(error.orig).startswith(NO_TEXT)) or str(error.orig) == NO_ARGUMENT:
            return DataLoss(f"the database is damaged: {error.orig}")
        if name.startswith("SQLITE_IOERR"):
            self.fail_stop.trip(f"{name}: {error.orig}")
        return StorageUncertain(f"the database failed: {error.orig}")
