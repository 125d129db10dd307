"""What SQLite's errors mean: no room, damaged, or uncertain until a restart."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy.exc import DatabaseError

from revisit.core.errors import DataLoss
from revisit.service.adapters.files.durable_files import may_grow
from revisit.service.adapters.files.fail_stop import FailStop
from revisit.service.application.contract.errors import StorageFull, StorageUncertain

FULL = ("SQLITE_FULL", "SQLITE_IOERR_SHMSIZE")
"""No room: in a file, or for the index of the write-ahead log."""

WRITE_FAILED = "SQLITE_IOERR_WRITE"
"""A broken disk; or a quota, or the limit of a file's size, which SQLite does not tell apart."""

FRAME_BYTES = 4096 + 24
"""The least by which the write-ahead log grows."""

DAMAGED = ("SQLITE_CORRUPT", "SQLITE_NOTADB")


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
