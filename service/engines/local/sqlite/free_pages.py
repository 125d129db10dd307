"""Giving pages of the database that rows have left back to the file system, a few at a time.

SQLite does so where the file was made with `auto_vacuum` (see `connections`): a page from the end takes the place of a
free one. A file of before this keeps its free pages, which new rows take.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import structlog
from sqlalchemy.exc import DatabaseError

from revisit.service.engines.local.sqlite.connections import INCREMENTAL
from revisit.service.engines.local.sqlite.transactions import StorageFailures, WriterLock

KEPT_PAGES = 1024
"""So many stay free: new rows come soon."""

PAGES_AT_ONCE = 256
"""Moved while the writers wait: about a megabyte, a few milliseconds."""

TURNS = 8
"""Of one call, with the other writers in between."""

log = structlog.get_logger(__name__)


class FreePages:
    """Keeps the file of one database short."""

    def __init__(self, database: Path, failures: StorageFailures) -> None:
        """`failures` acts on a disk that fails or is full."""
        self._database = database
        self._failures = failures

    def tend(self) -> int:
        """Give pages back, where there are many; how many. Blocks for as long as that takes.

        Raises StorageUncertain where a writer holds the database for 5 s or the disk fails; StorageFull, DataLoss.
        """
        given = 0
        lock = WriterLock(self._database)
        try:
            for _ in range(TURNS):
                with self._failures.translated(), lock.held():
                    pages = _given_back(self._database)
                given += pages
                if not pages:
                    break
        finally:
            lock.close()
        if given:
            log.debug("pages_given_back", pages=given)
        return given


def _given_back(database: Path) -> int:
    """Give back as many pages as may go at once; how many."""
    try:
        with closing(sqlite3.connect(database, timeout=5.0, isolation_level=None)) as connection:
            connection.execute("PRAGMA synchronous=FULL")
            ((mode,),) = connection.execute("PRAGMA auto_vacuum").fetchall()
            before = _free(connection)
            if mode != INCREMENTAL or before <= KEPT_PAGES:
                return 0
            connection.execute(f"PRAGMA incremental_vacuum({min(PAGES_AT_ONCE, before - KEPT_PAGES)})").fetchall()
            return before - _free(connection)
    except sqlite3.Error as error:
        raise DatabaseError("incremental_vacuum", None, error) from error


def _free(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA freelist_count").fetchone()[0])
