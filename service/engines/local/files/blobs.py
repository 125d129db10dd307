"""Blobs as files: tenant/kind/ab/abcdef..., named by content, written durably, checked when read."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import structlog

from revisit.core.errors import DataLoss
from revisit.service.domain.errors import StorageFull, StorageUncertain
from revisit.service.domain.identity import TenantId
from revisit.service.engines.local.files.disk import (
    NO_ROOM,
    TEMPORARY_PREFIX,
    FailStop,
    durable_write,
    make_directories,
    move_durably,
    open_folder,
    sync_directory,
)
from revisit.service.engines.stored_blobs import (
    QUARANTINE,
    BlobDamaged,
    key_of,
    missing,
    quarantined_name,
    require_whole,
)
from revisit.service.ports.blobs import StoredBlob

BLOCK_BYTES = 512
"""The unit of `st_blocks`, whatever a file system's own blocks are."""

PUT_TRIES = 5
"""A folder is rarely left empty in the moment in which a blob is written into it."""

log = structlog.get_logger(__name__)


class FileBlobStore:
    """`BlobStore` in a directory of this machine."""

    def __init__(
        self, root: Path, *, fail_stop: FailStop | None = None, on_full: Callable[[], None] = lambda: None
    ) -> None:
        """Blobs live below `root`, which is made where it is missing.

        An I/O error of the disk trips `fail_stop`; `on_full` is called where the disk is full.
        """
        self._root = root
        self._fail_stop = fail_stop or FailStop()
        self._on_full = on_full
        if not root.is_dir():
            root.mkdir(parents=True, exist_ok=True, mode=0o700)
            sync_directory(root.parent)

    def put(self, tenant: TenantId, kind: str, data: bytes) -> str:
        """See `BlobStore`."""
        sha256 = hashlib.sha256(data).hexdigest()
        path = self._path(tenant, kind, sha256)
        self._fail_stop.require_sound()
        with self._translated():
            for left in reversed(range(PUT_TRIES)):
                try:
                    self._keep(path, data)
                    break
                except FileNotFoundError:  # a deletion took the last blob of the folder, and the folder with it
                    if not left:
                        raise
        return sha256

    def _keep(self, path: Path, data: bytes) -> None:
        """Make a file hold data, durably. Raises OSError; FileNotFoundError where its folder went meanwhile."""
        if path.exists() and path.stat().st_size == len(data):
            # Another writer may have renamed it a moment ago, its directory not synced yet.
            sync_directory(path.parent)
            return
        make_directories(path.parent, self._root)
        durable_write(path, data)

    def get(self, tenant: TenantId, kind: str, sha256: str) -> bytes:
        """See `BlobStore`."""
        path = self._path(tenant, kind, sha256)
        try:
            return read_verified(path)
        except BlobDamaged:
            self._quarantine(path, tenant, kind)
            raise

    def exists(self, tenant: TenantId, kind: str, sha256: str) -> bool:
        """See `BlobStore`."""
        return self._path(tenant, kind, sha256).exists()

    def disk_bytes(self, tenant: TenantId, kind: str, sha256: str) -> int:
        """See `BlobStore`."""
        try:
            return self._path(tenant, kind, sha256).stat().st_blocks * BLOCK_BYTES
        except FileNotFoundError:
            return 0

    def delete(self, blobs: Collection[StoredBlob]) -> None:
        """See `BlobStore`. While a backup runs the files stay; the next sweep deletes them. Empty folders go, too."""
        with deleting(self._root) as may_delete:
            paths = [blob_path(self._root, blob) for blob in blobs if may_delete]
            for path in paths:
                path.unlink(missing_ok=True)
            for folder in {path.parent for path in paths}:
                with suppress(OSError):  # others are in it, or it has gone
                    folder.rmdir()

    def stored(self, older_than_s: float) -> Iterator[StoredBlob]:
        """See `BlobStore`. Deletes the temporary files of interrupted writes that it meets."""
        latest = time.time() - older_than_s
        for path in self._files():
            try:
                if path.stat().st_mtime > latest:
                    continue
            except FileNotFoundError:
                continue
            if path.name.startswith(TEMPORARY_PREFIX):
                path.unlink(missing_ok=True)
            else:
                tenant, kind, _, sha256 = path.relative_to(self._root).parts
                yield StoredBlob(TenantId(tenant), kind, sha256)

    def _files(self) -> Iterator[Path]:
        """The files of all folders; those that go with their last blob meanwhile have none."""
        for folder in self._root.glob("*/*/??"):
            with suppress(FileNotFoundError, NotADirectoryError):
                yield from list(folder.iterdir())

    def quarantined(self) -> int:
        """See `BlobStore`."""
        folder = self._root / QUARANTINE
        return sum(1 for _ in folder.iterdir()) if folder.is_dir() else 0

    def _path(self, tenant: TenantId, kind: str, sha256: str) -> Path:
        return blob_path(self._root, StoredBlob(tenant, kind, sha256))

    def _quarantine(self, path: Path, tenant: TenantId, kind: str) -> None:
        """Move a damaged blob away: the next `put` of its content then writes it anew."""
        log.error("blob_damaged", tenant=tenant, kind=kind, sha256=path.name)
        try:
            make_directories(self._root / QUARANTINE, self._root)
            move_durably(path, self._root / QUARANTINE / quarantined_name(StoredBlob(tenant, kind, path.name)))
        except OSError as error:
            log.warning("blob_not_quarantined", sha256=path.name, reason=error.strerror)

    @contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            if error.errno in NO_ROOM:
                self._on_full()
                raise StorageFull from error
            if error.errno == errno.EIO:
                self._fail_stop.trip(f"a blob could not be written: {error.strerror}")
            raise StorageUncertain(f"a blob could not be written: {error.strerror}") from error


def read_verified(path: Path) -> bytes:
    """A blob's bytes, checked against its file's name. Raises BlobDamaged; DataLoss where they cannot be read."""
    blob = StoredBlob(TenantId(path.parents[2].name), path.parents[1].name, path.name)
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise missing(blob) from error
    except OSError as error:
        raise DataLoss(f"the {blob.kind} {blob.sha256[:12]} cannot be read: {error.strerror}") from error
    return require_whole(blob, data)


def blob_path(root: Path, blob: StoredBlob) -> Path:
    """Where below `root` a blob lies. Raises DataLoss for an address that could lead elsewhere."""
    return root / key_of(blob)


@contextmanager
def deleting(root: Path) -> Iterator[bool]:
    """Whether blobs below `root` may be deleted within the block: not while a backup runs."""
    lock = open_folder(root)
    try:
        yield _try_shared(lock)
    finally:
        os.close(lock)


@contextmanager
def nothing_deleted(root: Path) -> Iterator[None]:
    """No process deletes a blob below `root` within the block. Waits for running deletions first."""
    lock = open_folder(root)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def _try_shared(lock: int) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
