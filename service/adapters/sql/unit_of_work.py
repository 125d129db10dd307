"""Transactions on SQLite: one writer thread per process, snapshots for readers, durable commits.

Why it looks like this (measured, docs/decisions/0011): Python's driver begins no transaction before a SELECT, so
read-modify-write loses updates; WAL with synchronous=NORMAL loses acknowledged rows in a power cut; SQLite before
3.51.3 can corrupt a WAL when two connections write or checkpoint at the same instant.
"""

from __future__ import annotations

import errno
import fcntl
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.exc import OperationalError

from service.adapters.leased_jobs import LeasedJobs
from service.adapters.sql import tables
from service.adapters.sql.repositories import SqlChangeLog, SqlJobs, SqlRepository, SqlScans, SqlWorkerLog
from service.application.errors import StorageFull, StorageUncertain
from service.application.ports import UnitOfWork
from service.application.records import (
    JobRecord,
    LoopRecord,
    MapRecord,
    RobotRecord,
    ScanRecord,
    SessionRecord,
    SubmapRecord,
)

T = TypeVar("T")

LOCK_TIMEOUT_S = 5.0
READERS = 2


@dataclass(frozen=True)
class SqlUnitOfWork:
    """`ports.UnitOfWork` over one connection in one transaction."""

    connection: Connection
    lease_ms: int

    @cached_property
    def maps(self) -> SqlRepository[MapRecord]:
        """Maps by (map_id)."""
        return SqlRepository(self.connection, tables.maps, MapRecord, ("map_id",))

    @cached_property
    def robots(self) -> SqlRepository[RobotRecord]:
        """Robots by (robot_id)."""
        return SqlRepository(self.connection, tables.robots, RobotRecord, ("robot_id",))

    @cached_property
    def sessions(self) -> SqlRepository[SessionRecord]:
        """Sessions by (map_id, session_id)."""
        return SqlRepository(self.connection, tables.sessions, SessionRecord, ("map_id", "session_id"))

    @cached_property
    def scans(self) -> SqlScans:
        """Scans by (map_id, session_id, seq)."""
        return SqlScans(self.connection, tables.scans, ScanRecord, ("map_id", "session_id", "seq"))

    @cached_property
    def submaps(self) -> SqlRepository[SubmapRecord]:
        """Submaps by (map_id, session_id, submap_id)."""
        return SqlRepository(self.connection, tables.submaps, SubmapRecord, ("map_id", "session_id", "submap_id"))

    @cached_property
    def loops(self) -> SqlRepository[LoopRecord]:
        """Loop closures by (map_id, loop_id)."""
        return SqlRepository(self.connection, tables.loops, LoopRecord, ("map_id", "loop_id"))

    @cached_property
    def jobs(self) -> SqlJobs:
        """Jobs by (operation_id)."""
        return SqlJobs(self.connection, tables.jobs, JobRecord, ("operation_id",))

    @cached_property
    def queue(self) -> LeasedJobs:
        """The job queue in this transaction."""
        return LeasedJobs(self.jobs, self.lease_ms)

    @cached_property
    def changes(self) -> SqlChangeLog:
        """The index's change log."""
        return SqlChangeLog(self.connection)

    @cached_property
    def workers(self) -> SqlWorkerLog:
        """The living workers."""
        return SqlWorkerLog(self.connection)


class SqlTransactions:
    """`ports.Transactions` on a SQLite file that `migrate` has prepared."""

    def __init__(
        self,
        path: Path,
        *,
        checkpoints: bool,
        lease_ms: int = 10_000,
        on_uncertain: Callable[[], None] = lambda: None,
    ) -> None:
        """`checkpoints`: this process folds the WAL back into the database (one process does: the gateway).

        `on_uncertain` is called after an I/O error of the database: the process should stop and recover.
        """
        self._writer = writer_engine(path, checkpoints=checkpoints)
        self._reader = reader_engine(path)
        self._lock = WriterLock(path)
        self._lease_ms = lease_ms
        self._on_uncertain = on_uncertain
        self._writing = ThreadPoolExecutor(1, thread_name_prefix="writer")
        self._reading = ThreadPoolExecutor(READERS, thread_name_prefix="reader")

    def write(self, work: Callable[[UnitOfWork], T]) -> Future[T]:
        """See `ports.Transactions`."""
        return self._writing.submit(self._write, work)

    def read(self, work: Callable[[UnitOfWork], T]) -> Future[T]:
        """See `ports.Transactions`."""
        return self._reading.submit(self._read, work)

    def close(self) -> None:
        """See `ports.Transactions`."""
        self._writing.shutdown(wait=True)
        self._reading.shutdown(wait=True)
        self._reader.dispose()
        self._writer.dispose()
        self._lock.close()

    def _write(self, work: Callable[[UnitOfWork], T]) -> T:
        with self._translated(), self._lock.held(), self._writer.begin() as connection:
            return work(SqlUnitOfWork(connection, self._lease_ms))

    def _read(self, work: Callable[[UnitOfWork], T]) -> T:
        with self._translated(), self._reader.begin() as connection:
            return work(SqlUnitOfWork(connection, self._lease_ms))

    @contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except OperationalError as error:
            text = str(error.orig)
            if "full" in text:
                raise StorageFull from error
            if "I/O" in text:
                self._on_uncertain()
            raise StorageUncertain(f"the database failed: {text}") from error


class WriterLock:
    """A lock between processes that a writer holds for each transaction, its checkpoint included.

    SQLite's own lock admits a writer and a checkpoint at once, which its WAL-reset fault needs; and waiting for it
    sleeps in growing steps. The kernel frees this lock with its process, however that ends.
    """

    def __init__(self, database: Path) -> None:
        """The lock file lies beside `database`."""
        self._descriptor = os.open(f"{database}.writer", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the lock. Raises StorageUncertain after 5 s, with nothing written."""
        deadline = time.monotonic() + LOCK_TIMEOUT_S
        while not self._try():
            if time.monotonic() > deadline:
                raise StorageUncertain("another process holds the database; nothing was stored")
            time.sleep(0.001)
        try:
            yield
        finally:
            fcntl.flock(self._descriptor, fcntl.LOCK_UN)

    def close(self) -> None:
        """Give the file back."""
        os.close(self._descriptor)

    def _try(self) -> bool:
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.EACCES):
                return False
            raise
        return True


def writer_engine(path: Path, *, checkpoints: bool) -> Engine:
    """An engine whose transactions take the write lock at once and are on disk when their commit returns."""
    engine = create_engine(f"sqlite:///{path}", pool_size=1, max_overflow=0)
    pragmas = ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", "busy_timeout=5000")
    _prepare(engine, (*pragmas, f"wal_autocheckpoint={1000 if checkpoints else 0}"), "BEGIN IMMEDIATE")
    return engine


def reader_engine(path: Path) -> Engine:
    """An engine whose transactions see one snapshot and can change nothing."""
    engine = create_engine(f"sqlite:///{path}", pool_size=READERS, max_overflow=0)
    _prepare(engine, ("query_only=ON", "busy_timeout=5000", "wal_autocheckpoint=0"), "BEGIN")
    return engine


def _prepare(engine: Engine, pragmas: tuple[str, ...], begin: str) -> None:
    @event.listens_for(engine, "connect")
    def set_pragmas(connection: Any, _record: Any) -> None:
        # The driver must not begin transactions by itself: it would do so only before a write.
        connection.isolation_level = None
        for pragma in pragmas:
            connection.execute(f"PRAGMA {pragma}")

    @event.listens_for(engine, "begin")
    def begin_transaction(connection: Connection) -> None:
        connection.exec_driver_sql(begin)
