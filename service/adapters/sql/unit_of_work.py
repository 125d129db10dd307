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
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.exc import DatabaseError

from revisit.core.errors import DataLoss
from revisit.service.adapters.durable_files import may_grow, open_lock
from revisit.service.adapters.fail_stop import FailStop
from revisit.service.adapters.leased_jobs import LeasedJobs
from revisit.service.adapters.sql import tables
from revisit.service.adapters.sql.access import SqlAuditTrail, SqlKeyRing
from revisit.service.adapters.sql.group_commit import GroupCommitter
from revisit.service.adapters.sql.repositories import (
    SqlChangeLog,
    SqlJobs,
    SqlRepository,
    SqlScans,
    SqlSubmaps,
    SqlWorkerLog,
)
from revisit.service.application.contract.errors import StorageFull, StorageUncertain
from revisit.service.application.contract.ports import UnitOfWork
from revisit.service.application.contract.records import (
    JobRecord,
    LoopRecord,
    MapRecord,
    RobotRecord,
    ScanRecord,
    SessionRecord,
    SubmapRecord,
)
from revisit.service.failpoints import failpoint

T = TypeVar("T")

LOCK_TIMEOUT_S = 5.0
READERS = 2

WRITER_PRAGMAS: dict[str, str | int] = {
    "journal_mode": "wal",
    "synchronous": 2,  # FULL: a commit returns when it is on the disk
    "foreign_keys": 1,
    "busy_timeout": 5000,
    "journal_size_limit": 64 * 2**20,  # bytes: a WAL that has grown beyond is cut back by the next checkpoint
    "temp_store": 2,  # MEMORY: a full disk cannot break a rollback
    "secure_delete": 1,  # deleted rows are overwritten
}
READER_PRAGMAS: dict[str, str | int] = {"query_only": 1, "busy_timeout": 5000, "wal_autocheckpoint": 0}

FULL = ("SQLITE_FULL", "SQLITE_IOERR_SHMSIZE")
"""No room: in a file, or for the index of the WAL."""

WRITE_FAILED = "SQLITE_IOERR_WRITE"
"""A broken disk; or a quota or a limit on the size of files, which SQLite does not tell from it."""

FRAME_BYTES = 4096 + 24
"""What the WAL grows by, at least."""

DAMAGED = ("SQLITE_CORRUPT", "SQLITE_NOTADB")


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
    def submaps(self) -> SqlSubmaps:
        """Submaps by (map_id, session_id, submap_id)."""
        return SqlSubmaps(self.connection, tables.submaps, SubmapRecord, ("map_id", "session_id", "submap_id"))

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

    @cached_property
    def keys(self) -> SqlKeyRing:
        """API keys."""
        return SqlKeyRing(self.connection)

    @cached_property
    def audit(self) -> SqlAuditTrail:
        """The audit log."""
        return SqlAuditTrail(self.connection)


class SqlTransactions:
    """`ports.Transactions` on a SQLite file that `migrate` has prepared."""

    def __init__(
        self,
        path: Path,
        *,
        checkpoints: bool,
        lease_ms: int = 10_000,
        fail_stop: FailStop | None = None,
        on_full: Callable[[], None] = lambda: None,
    ) -> None:
        """`checkpoints`: this process folds the WAL back into the database (one process does: the gateway).

        `fail_stop` is thrown by the first I/O error of the database, `on_full` called where the disk has no room.
        Raises RuntimeError where the connections are not as durable, or as harmless, as they must be.
        """
        self._writer = writer_engine(path, checkpoints=checkpoints)
        self._reader = reader_engine(path)
        require_pragmas(self._writer, WRITER_PRAGMAS | _checkpointing(checkpoints))
        require_pragmas(self._reader, READER_PRAGMAS)
        self._lock = WriterLock(path)
        self._wal = path.with_name(f"{path.name}-wal")
        self._lease_ms = lease_ms
        self._fail_stop = fail_stop or FailStop()
        self._on_full = on_full
        self._writing = GroupCommitter(self._transaction)
        self._reading = ThreadPoolExecutor(READERS, thread_name_prefix="reader")

    def write(self, work: Callable[[UnitOfWork], T], *, alone: bool = False) -> Future[T]:
        """See `ports.Transactions`."""
        return self._writing.submit(lambda connection: work(SqlUnitOfWork(connection, self._lease_ms)), alone=alone)

    def read(self, work: Callable[[UnitOfWork], T]) -> Future[T]:
        """See `ports.Transactions`."""
        return self._reading.submit(self._read, work)

    def close(self) -> None:
        """See `ports.Transactions`."""
        self._writing.close()
        self._reading.shutdown(wait=True)
        self._reader.dispose()
        self._writer.dispose()
        self._lock.close()

    @contextmanager
    def _transaction(self) -> Iterator[Connection]:
        self._fail_stop.require_sound()
        with self._translated(), self._lock.held():
            with self._writer.begin() as connection:
                yield connection
                failpoint("commit.before")
            failpoint("commit.after")

    def _read(self, work: Callable[[UnitOfWork], T]) -> T:
        with self._translated(), self._reader.begin() as connection:
            return work(SqlUnitOfWork(connection, self._lease_ms))

    @contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except DatabaseError as error:
            raise self._refusal(error) from error

    def _refusal(self, error: DatabaseError) -> Exception:
        """What a failure of SQLite means to those who asked; an I/O error throws the switch."""
        name = str(getattr(error.orig, "sqlite_errorname", ""))
        if name in FULL or (name == WRITE_FAILED and not may_grow(self._wal, FRAME_BYTES)):
            self._on_full()
            return StorageFull()
        if name in DAMAGED:
            return DataLoss(f"the database is damaged: {error.orig}")
        if name.startswith("SQLITE_IOERR"):
            self._fail_stop.trip(f"{name}: {error.orig}")
        return StorageUncertain(f"the database failed: {error.orig}")


class WriterLock:
    """A lock between processes that a writer holds for each transaction, its checkpoint included.

    SQLite's own lock admits a writer and a checkpoint at once, which its WAL-reset fault needs; and waiting for it
    sleeps in growing steps. The kernel frees this lock with its process, however that ends. Whoever wants it waits in
    turn: the first in the line holds the turnstile, so a busy process cannot take the lock twice while another waits.
    """

    def __init__(self, database: Path) -> None:
        """The lock files lie beside `database`."""
        self._writer = open_lock(database.with_name(f"{database.name}.writer"))
        self._turnstile = open_lock(database.with_name(f"{database.name}.turn"))

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the lock. Raises StorageUncertain after 5 s, with nothing written."""
        deadline = time.monotonic() + LOCK_TIMEOUT_S
        with ExitStack() as holding:
            with _locked(self._turnstile, deadline):
                holding.enter_context(_locked(self._writer, deadline))
            yield

    def close(self) -> None:
        """Give the files back."""
        os.close(self._writer)
        os.close(self._turnstile)


@contextmanager
def _locked(descriptor: int, deadline: float) -> Iterator[None]:
    """Hold one `flock`. Raises StorageUncertain at `deadline` of the monotonic clock."""
    while not _try_lock(descriptor):
        if time.monotonic() > deadline:
            raise StorageUncertain("another process holds the database; nothing was stored")
        time.sleep(0.001)
    try:
        yield
    finally:
        fcntl.flock(descriptor, fcntl.LOCK_UN)


def _try_lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES):
            return False
        raise
    return True


def writer_engine(path: Path, *, checkpoints: bool) -> Engine:
    """An engine whose transactions take the write lock at once and are on disk when their commit returns."""
    engine = create_engine(f"sqlite:///{path}", pool_size=1, max_overflow=0)
    _prepare(engine, WRITER_PRAGMAS | _checkpointing(checkpoints), "BEGIN IMMEDIATE")
    return engine


def reader_engine(path: Path) -> Engine:
    """An engine whose transactions see one snapshot and can change nothing."""
    engine = create_engine(f"sqlite:///{path}", pool_size=READERS, max_overflow=0)
    _prepare(engine, READER_PRAGMAS, "BEGIN")
    return engine


def require_pragmas(engine: Engine, pragmas: dict[str, str | int]) -> None:
    """Raises RuntimeError where a connection is not as `pragmas` demand: SQLite ignores what it cannot grant."""
    with engine.connect() as connection:
        granted = {name: connection.exec_driver_sql(f"PRAGMA {name}").scalar() for name in pragmas}
    wrong = {name: value for name, value in granted.items() if value != pragmas[name]}
    if wrong:
        raise RuntimeError(f"the database connection has {wrong}, not { ({name: pragmas[name] for name in wrong}) }")


def _checkpointing(checkpoints: bool) -> dict[str, str | int]:
    return {"wal_autocheckpoint": 1000 if checkpoints else 0}


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
