"""Transactions on SQLite: one writer thread per process, snapshots for readers, durable commits.

Why it looks like this (measured, docs/decisions/0011): Python's driver begins no transaction before a SELECT, so
read-modify-write loses updates; with synchronous=NORMAL a power cut loses acknowledged rows of the write-ahead log;
SQLite before 3.51.3 can damage the log when two connections write or checkpoint at the same instant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from sqlalchemy import Connection

from revisit.service.adapters.files.fail_stop import FailStop
from revisit.service.adapters.sql.unit_of_work import SqlUnitOfWork
from revisit.service.adapters.sqlite.connections import (
    READER_PRAGMAS,
    READERS,
    reader_engine,
    require_pragmas,
    write_ahead_log,
    writer_engine,
    writer_pragmas,
)
from revisit.service.adapters.sqlite.engine import SqliteEngine
from revisit.service.adapters.sqlite.failures import StorageFailures
from revisit.service.adapters.sqlite.group_commit import GroupCommitter
from revisit.service.adapters.sqlite.writer_lock import WriterLock
from revisit.service.application.contract.transactions import UnitOfWork
from revisit.service.failpoints import failpoint

T = TypeVar("T")


class SqliteTransactions:
    """`Transactions` on a SQLite file that `migrate` has prepared."""

    def __init__(
        self,
        path: Path,
        *,
        checkpoints: bool,
        lease_ms: int = 10_000,
        fail_stop: FailStop | None = None,
        on_full: Callable[[], None] = lambda: None,
    ) -> None:
        """`checkpoints`: this process copies the write-ahead log into the database (one process does: the gateway).

        `fail_stop` is tripped by the first I/O error of the database, `on_full` called where the disk has no room.
        Raises RuntimeError where the connections are not as durable, or as harmless, as they must be.
        """
        self._writer = writer_engine(path, checkpoints=checkpoints)
        self._reader = reader_engine(path)
        require_pragmas(self._writer, writer_pragmas(checkpoints=checkpoints))
        require_pragmas(self._reader, READER_PRAGMAS)
        self._engine = SqliteEngine()
        self._lock = WriterLock(path)
        self._lease_ms = lease_ms
        self._fail_stop = fail_stop or FailStop()
        self._failures = StorageFailures(write_ahead_log(path), self._fail_stop, on_full)
        self._writing = GroupCommitter(self._transaction)
        self._reading = ThreadPoolExecutor(READERS, thread_name_prefix="reader")

    def write(self, work: Callable[[UnitOfWork], T], *, alone: bool = False) -> Future[T]:
        """See `Transactions`."""
        return self._writing.submit(lambda connection: work(self._unit_of_work(connection)), alone=alone)

    def read(self, work: Callable[[UnitOfWork], T]) -> Future[T]:
        """See `Transactions`."""
        return self._reading.submit(self._read, work)

    def close(self) -> None:
        """See `Transactions`."""
        self._writing.close()
        self._reading.shutdown(wait=True)
        self._reader.dispose()
        self._writer.dispose()
        self._lock.close()

    @contextmanager
    def _transaction(self) -> Iterator[Connection]:
        self._fail_stop.require_sound()
        with self._failures.translated(), self._lock.held():
            with self._writer.begin() as connection:
                yield connection
                failpoint("commit.before")
            failpoint("commit.after")

    def _read(self, work: Callable[[UnitOfWork], T]) -> T:
        with self._failures.translated(), self._reader.begin() as connection:
            return work(self._unit_of_work(connection))

    def _unit_of_work(self, connection: Connection) -> UnitOfWork:
        return SqlUnitOfWork(connection, self._engine, self._lease_ms)
