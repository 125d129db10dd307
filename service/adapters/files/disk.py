"""The disk of the data folder when it is full, and when it fails.

On a full disk a database cannot even delete rows. So an empty file reserves some space. It is deleted when the disk
runs full and made again when there is space for it.

Once a disk has failed to sync, nothing more is acknowledged and the process ends. After a failed fsync the kernel may
mark the pages clean although they never reached the disk. A second fsync that succeeds therefore proves nothing: only
a restart, which reads what is really there, can tell what was stored.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path

import structlog

from revisit.service.adapters.files.durable_files import make_room
from revisit.service.application.contract.errors import StorageUncertain

FLOOR_SHARE = 4
"""The disk counts as full where less than a quarter of the reserve is free beside it."""


class Disk:
    """`DiskSpace` of one folder. Its state is the reserve file itself, so that all processes agree."""

    def __init__(self, home: Path, reserve_bytes: int, log: Path | None = None) -> None:
        """Reserves `reserve_bytes` in `home`; with 0 the disk never counts as full.

        `log` is the write-ahead log of the database, where that is a file of this machine.
        """
        self._home = home
        self._log = log
        self._reserve = home / "reserve"
        self._reserve_bytes = reserve_bytes
        self._floor_bytes = reserve_bytes // FLOOR_SHARE

    def full(self) -> bool:
        """See `DiskSpace`. Releases the reserve when the disk runs full."""
        if self._reserve_bytes == 0:
            return False
        if self.exhausted():
            self.release()
        return not self._reserve.exists()

    def exhausted(self) -> bool:
        """See `DiskSpace`."""
        return self.free_bytes() < self._floor_bytes

    def wal_bytes(self) -> int:
        """See `DiskSpace`."""
        return self._log.stat().st_size if self._log is not None and self._log.exists() else 0

    def free_bytes(self) -> int:
        """How much this user may still write."""
        disk = os.statvfs(self._home)
        return disk.f_bavail * disk.f_frsize

    def release(self) -> None:
        """Delete the reserve: from now on the disk counts as full, and stored data can be processed and deleted."""
        if self._reserve.exists():
            log.warning("storage_full", free_bytes=self.free_bytes(), released_bytes=self._reserve_bytes)
            self._reserve.unlink(missing_ok=True)

    def tend(self) -> None:
        """Release the reserve when the disk runs full, make it again when there is space. To be called often."""
        if self.full() and self.free_bytes() >= self._reserve_bytes + 2 * self._floor_bytes:
            try:
                make_room(self._reserve, self._reserve_bytes)
            except OSError as error:
                log.warning("reserve_not_made", reason=error.strerror)
                return
            log.info("storage_has_room", free_bytes=self.free_bytes())


log = structlog.get_logger(__name__)


class FailStop:
    """The switch that all stores of a process share: tripped once, never reset."""

    def __init__(self, stop: Callable[[], None] = lambda: None) -> None:
        """`stop` is called once, in the thread that met the error. It should end the process soon."""
        self._stop = stop
        self._lock = threading.Lock()
        self._tripped = False

    @property
    def tripped(self) -> bool:
        """Whether storage has failed."""
        return self._tripped

    def trip(self, reason: str) -> None:
        """Storage has failed: refuse every later write and end the process."""
        with self._lock:
            first, self._tripped = not self._tripped, True
        if first:
            log.critical("storage_failed", reason=reason)
            self._stop()

    def require_sound(self) -> None:
        """Raises StorageUncertain once storage has failed."""
        if self._tripped:
            raise StorageUncertain("storage has failed and the service is restarting")
