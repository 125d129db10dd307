"""The room on the disk of the data, and a reserve of it for the time when there is none.

A full disk leaves SQLite unable even to delete. So a file that holds nothing keeps some room; it is given up when the
disk runs full, and made again once there is room for it.
"""

from __future__ import annotations

import os
from pathlib import Path

import structlog

from revisit.service.adapters.files.durable_files import make_room

FLOOR_SHARE = 4
"""The disk counts as full where less than a quarter of the reserve is free beside it."""

log = structlog.get_logger(__name__)


class Disk:
    """`ports.DiskSpace` of one directory. Its state is the reserve file itself, so that all processes agree."""

    def __init__(self, home: Path, reserve_bytes: int) -> None:
        """`reserve_bytes` of the disk are kept in `home`; 0 for none, and then the disk never counts as full."""
        self._home = home
        self._reserve = home / "reserve"
        self._reserve_bytes = reserve_bytes
        self._floor_bytes = reserve_bytes // FLOOR_SHARE

    def full(self) -> bool:
        """See `ports.DiskSpace`. Releases the reserve where the disk runs full."""
        if self._reserve_bytes == 0:
            return False
        if self.exhausted():
            self.release()
        return not self._reserve.exists()

    def exhausted(self) -> bool:
        """See `ports.DiskSpace`."""
        return self.free_bytes() < self._floor_bytes

    def wal_bytes(self) -> int:
        """See `ports.DiskSpace`."""
        wal = self._home / "revisit.db-wal"
        return wal.stat().st_size if wal.exists() else 0

    def free_bytes(self) -> int:
        """What this user may still write."""
        disk = os.statvfs(self._home)
        return disk.f_bavail * disk.f_frsize

    def release(self) -> None:
        """Give up the reserve: from now on the disk counts as full, and what is there can be worked on."""
        if self._reserve.exists():
            log.warning("storage_full", free_bytes=self.free_bytes(), released_bytes=self._reserve_bytes)
            self._reserve.unlink(missing_ok=True)

    def tend(self) -> None:
        """Release the reserve where the disk runs full, make it again where there is room; to be called often."""
        if self.full() and self.free_bytes() >= self._reserve_bytes + 2 * self._floor_bytes:
            try:
                make_room(self._reserve, self._reserve_bytes)
            except OSError as error:
                log.warning("reserve_not_made", reason=error.strerror)
                return
            log.info("storage_has_room", free_bytes=self.free_bytes())
