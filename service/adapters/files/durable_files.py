"""Files that survive a power cut: the only place of the service that makes files (tests/architecture holds it to that).

A file is written under a temporary name, synced, renamed, and its directory synced, in this order. `make_room` stores
no data: it reserves blocks of the disk, which are released when the disk fills up.
"""

from __future__ import annotations

import errno
import fcntl
import os
import resource
import secrets
from pathlib import Path

from revisit.service.failpoints import failpoint

TEMPORARY_PREFIX = "."
"""Begins the name of a file that is being written; a crash may leave one behind."""

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""The kernel's errors for no space: on the disk, in a quota, or within the limit of a file's size."""


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
