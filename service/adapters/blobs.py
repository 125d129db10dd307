"""Blobs as files: tenant/kind/ab/abcdef..., named by content, written durably, checked when read."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
from pathlib import Path

from core.errors import DataLoss
from service.application.errors import StorageFull, StorageUncertain
from service.application.identity import TenantId

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", re.ASCII)


class FileBlobStore:
    """`ports.BlobStore` in a directory of this machine."""

    def __init__(self, root: Path) -> None:
        """Blobs live below `root`, which is made where it is missing."""
        self._root = root
        root.mkdir(parents=True, exist_ok=True, mode=0o700)

    def put(self, tenant: TenantId, kind: str, data: bytes) -> str:
        """See `ports.BlobStore`."""
        sha256 = hashlib.sha256(data).hexdigest()
        path = self._path(tenant, kind, sha256)
        try:
            if path.exists() and path.stat().st_size == len(data):
                # Another writer may have renamed it a moment ago, its directory not synced yet.
                sync_directory(path.parent)
                return sha256
            make_directories(path.parent, self._root)
            durable_write(path, data)
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                raise StorageFull from error
            raise StorageUncertain(f"a blob could not be written: {error.strerror}") from error
        return sha256

    def get(self, tenant: TenantId, kind: str, sha256: str) -> bytes:
        """See `ports.BlobStore`."""
        try:
            data = self._path(tenant, kind, sha256).read_bytes()
        except FileNotFoundError as error:
            raise DataLoss(f"the {kind} {sha256[:12]} is missing") from error
        if hashlib.sha256(data).hexdigest() != sha256:
            raise DataLoss(f"the {kind} {sha256[:12]} is damaged")
        return data

    def exists(self, tenant: TenantId, kind: str, sha256: str) -> bool:
        """See `ports.BlobStore`."""
        return self._path(tenant, kind, sha256).exists()

    def delete(self, tenant: TenantId, kind: str, sha256: str) -> None:
        """See `ports.BlobStore`."""
        self._path(tenant, kind, sha256).unlink(missing_ok=True)

    def _path(self, tenant: TenantId, kind: str, sha256: str) -> Path:
        if not all(_NAME.fullmatch(part) for part in (tenant, kind, sha256)):
            raise DataLoss("a blob's address is damaged")
        return self._root / tenant / kind / sha256[:2] / sha256


def durable_write(path: Path, data: bytes) -> None:
    """Make `path` hold `data`, all or nothing, surviving a power cut once this returns: the only way files are made.

    Raises OSError; then the file is as it was before.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}")
    try:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    sync_directory(path.parent)


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
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
