"""The disk: files that survive a power cut; behaviour when the disk is full or fails.

This is the only place of the service that makes files (tests/architecture holds it to that). A file is written under a
temporary name, synced, renamed, and its directory synced, in this order.

On a full disk a database cannot even delete rows. So an empty file reserves some space. It is deleted when the disk
runs full and made again when there is space for it.

Once a disk has failed to sync, nothing more is acknowledged and the process ends. After a failed fsync the kernel may
mark the pages clean although they never reached the disk. A second fsync that succeeds therefore proves nothing:
only a restart, which reads the disk itself, shows the stored data.
"""

from __future__ import annotations

import errno
import fcntl
import os
import resource
import secrets
import threading
from collections.abc import Callable, Iterable
from pathlib import Path

import structlog

from revisit.service.domain.errors import StorageUncertain
from revisit.service.failpoints import failpoint

TEMPORARY_PREFIX = "."
"""Begins the name of a file that is being written; a crash may leave one behind."""

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""The kernel's errors for no space: on the disk, in a quota, or within the limit of a file's size."""

FLOOR_SHARE = 4
"""The disk counts as full where less than a quarter of the reserve is free beside it."""

log = structlog.get_logger(__name__)


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

    def log_bytes(self) -> int:
        """See `DiskSpace`."""
        return self._log.stat().st_size if self._log is not None and self._log.exists() else 0

    def free_bytes(self) -> int:
        """See `DiskSpace`."""
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


def durable_write(path: Path, data: bytes, *, is_blob: bool = True) -> None:
    """Make `path` hold `data`, all or nothing, surviving a power cut once this returns.

    The failpoints count blobs only. Raises OSError; then the file is as it was before.
    """
    temporary = path.with_name(f"{TEMPORARY_PREFIX}{path.name}.{os.getpid()}.{secrets.token_hex(4)}")
    try:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            if is_blob:
                failpoint("blob.before_sync")
            os.fsync(file.fileno())
        if is_blob:
            failpoint("blob.before_rename")
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    if is_blob:
        failpoint("blob.before_directory_sync")
    sync_directory(path.parent)


def write_later_synced(path: Path, data: bytes) -> None:
    """Write a new file that survives a power cut only after `os.sync`; for many files that only count together."""
    with open(path, "xb", opener=_private) as file:
        file.write(data)


def replaceable_write(path: Path, pieces: Iterable[bytes]) -> None:
    """Make `path` hold the pieces, all or nothing for other processes, but not for a power cut.

    For data that can be made again and has its own hash. Raises OSError and the errors of the pieces; then there is no
    file.
    """
    temporary = path.with_name(f"{TEMPORARY_PREFIX}{path.name}")
    try:
        with open(temporary, "xb", opener=_private) as file:
            file.writelines(pieces)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def erase_in_place(path: Path, starts: Iterable[int], length: int) -> None:
    """Overwrite `length` bytes of a file with zeros from each of the `starts`. Raises OSError."""
    zeros, descriptor = bytes(length), os.open(path, os.O_WRONLY | os.O_CLOEXEC)
    try:
        for start in starts:
            os.pwrite(descriptor, zeros, start)
    finally:
        os.close(descriptor)


def make_directories(path: Path, root: Path) -> None:
    """Make `path` and its parents below `root`, durably."""
    if path.is_dir():
        return
    if path != root:
        make_directories(path.parent, root)
    path.mkdir(exist_ok=True, mode=0o700)
    sync_directory(path.parent)


def sync_directory(path: Path) -> None:
    """Make the names in a directory survive a power cut."""
    descriptor = open_folder(path)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_room(path: Path, size_bytes: int) -> None:
    """Reserve `size_bytes` of the disk in an empty file. Raises OSError; then there is no such file."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        os.posix_fallocate(descriptor, 0, size_bytes)
    except OSError:
        path.unlink(missing_ok=True)
        raise
    finally:
        os.close(descriptor)


def may_grow(path: Path, by_bytes: int) -> bool:
    """Whether a file may become longer by `by_bytes`, within the free space, limits and quotas of this process."""
    limit_bytes, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
    size_bytes = path.stat().st_size if path.exists() else 0
    if limit_bytes != resource.RLIM_INFINITY and size_bytes + by_bytes > limit_bytes:
        return False
    trial = path.with_name(f"{TEMPORARY_PREFIX}trial")
    try:
        make_room(trial, by_bytes)
    except OSError as error:
        return error.errno not in NO_ROOM
    trial.unlink(missing_ok=True)
    return True


def move_durably(path: Path, target: Path) -> None:
    """Rename, surviving a power cut. Raises OSError."""
    path.replace(target)
    sync_directory(target.parent)
    sync_directory(path.parent)


def open_lock(path: Path) -> int:
    """Open (or make) a file to be locked with `flock`; the descriptor, which the caller closes."""
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)


def open_folder(path: Path) -> int:
    """Open a folder, to be synced or locked; the descriptor, which the caller closes."""
    return os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)


def try_lock(descriptor: int) -> bool:
    """Take the `flock` of an open file or folder, unless somebody else has it; closing the descriptor gives it back."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES):
            return False
        raise
    return True


def _private(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_CLOEXEC, 0o600)
