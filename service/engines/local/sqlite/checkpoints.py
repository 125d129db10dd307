"""Folding the write-ahead log back into the database by time and size, for all writers.

The gateway's own commits fold it back once 4000 pages (16 MiB) are in it;
the workers' commits (a heartbeat every 2 s, and their results) waited for the next of them, which in an idle or
draining service never came. The size of the file does not give the amount to fold back: it is written anew from its
beginning, and stays as long as it ever was.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import structlog
from sqlalchemy.exc import DatabaseError

from revisit.service.engines.local.sqlite.connections import write_ahead_log
from revisit.service.engines.local.sqlite.transactions import StorageFailures, WriterLock

OLD_S = 30.0
"""The log is folded back this long after the last time."""

LARGE_BYTES = 32 * 2**20
"""A file beyond this is folded back and cut to nothing at once, for which the readers of the moment are waited for."""

READERS_S = 0.25

log = structlog.get_logger(__name__)


class Checkpoints:
    """Keeps the log of one database short."""

    def __init__(self, database: Path, failures: StorageFailures, now_s: Callable[[], float] = time.monotonic) -> None:
        """`failures` acts on a disk that fails or is full; `now_s` is a monotonic clock."""
        self._database = database
        self._failures = failures
        self._log = write_ahead_log(database)
        self._now_s = now_s
        self._last_s = now_s()

    def tend(self) -> None:
        """Fold the log back where it is large or old; to be called often. Blocks for as long as that takes.

        Raises StorageUncertain where a writer holds the database for 5 s or the disk fails; StorageFull, DataLoss.
        """
        size_bytes = self._log.stat().st_size if self._log.exists() else 0
        large, old = size_bytes > LARGE_BYTES, self._now_s() - self._last_s >= OLD_S
        if large or (old and size_bytes):
            self._fold_back("TRUNCATE" if large else "PASSIVE")
            self._last_s = self._now_s()

    def _fold_back(self, mode: str) -> None:
        """Checkpoint under the writers' lock: nobody else may write meanwhile (see `WriterLock`)."""
        lock = WriterLock(self._database)
        try:
            with self._failures.translated(), lock.held():
                busy, pages, folded = _checkpoint(self._database, mode)
        finally:
            lock.close()
        log.debug("log_folded_back", mode=mode, busy=busy, pages=pages, folded=folded)


def _checkpoint(database: Path, mode: str) -> tuple[int, int, int]:
    """SQLite's report of a checkpoint: whether it was blocked, pages in the log, pages folded back."""
    try:
        with closing(sqlite3.connect(database, timeout=READERS_S)) as connection:
            connection.execute("PRAGMA synchronous=FULL")
            row: tuple[int, int, int] = connection.execute(f"PRAGMA wal_checkpoint({mode})").fetchone()
            return row
    except sqlite3.Error as error:
        raise DatabaseError("wal_checkpoint", None, error) from error
