"""Names and bytes of stored blobs, the same in every store: tenant/kind/ab/abcdef..., checked when they are read."""

from __future__ import annotations

import hashlib
import re
from typing import Protocol

from revisit.core.errors import DataLoss
from revisit.service.domain.identity import TenantId
from revisit.service.ports.blobs import StoredBlob

QUARANTINE = ".quarantine"
"""The folder of damaged blobs: nothing in it is served, an operator can look at it."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", re.ASCII)


class BlobDamaged(DataLoss):
    """The bytes of a blob do not have the hash in its name."""


class BlobStoreUnusable(Exception):
    """The bucket cannot be used; `for_good`: until somebody has mended a setting or a right."""

    def __init__(self, url: str, reason: str, *, for_good: bool) -> None:
        """`reason` is a line for the operator."""
        super().__init__(f"{url} cannot be used: {reason}")
        self.for_good = for_good


class Bucket(Protocol):
    """A store of blobs outside the data folder, as those see it who look after the data."""

    url: str

    def put(self, tenant: TenantId, kind: str, data: bytes) -> str:
        """See `BlobStore`."""
        ...

    def get(self, tenant: TenantId, kind: str, sha256: str) -> bytes:
        """See `BlobStore`."""
        ...

    def read(self, blob: StoredBlob) -> bytes:
        """The bytes of a blob; a damaged one is left alone. Raises DataLoss, StorageUncertain."""
        ...

    def exists(self, tenant: TenantId, kind: str, sha256: str) -> bool:
        """See `BlobStore`."""
        ...

    def quarantined(self) -> int:
        """See `BlobStore`."""
        ...

    def try_out(self) -> bool:
        """Store, read, list and delete an object; whether the bucket keeps versions of what is deleted.

        Raises BlobStoreUnusable.
        """
        ...


def key_of(blob: StoredBlob) -> str:
    """Where a blob lies in its store. Raises DataLoss for an address that could lead elsewhere."""
    if not all(_NAME.fullmatch(part) for part in (blob.tenant, blob.kind, blob.sha256)):
        raise DataLoss("a blob's address is damaged")
    return f"{blob.tenant}/{blob.kind}/{blob.sha256[:2]}/{blob.sha256}"


def blob_at(key: str) -> StoredBlob | None:
    """The blob that lies there; None where it is something else."""
    parts = key.split("/")
    if len(parts) != 4 or not all(_NAME.fullmatch(part) for part in parts):
        return None
    return StoredBlob(TenantId(parts[0]), parts[1], parts[3])


def quarantined_name(blob: StoredBlob) -> str:
    """The name of a damaged blob in the quarantine."""
    return f"{blob.tenant}.{blob.kind}.{blob.sha256}"


def missing(blob: StoredBlob) -> DataLoss:
    """The error of a blob that is not there."""
    return DataLoss(f"the {blob.kind} {blob.sha256[:12]} is missing")


def require_whole(blob: StoredBlob, data: bytes) -> bytes:
    """The bytes. Raises BlobDamaged where they do not have the hash in the blob's name."""
    if hashlib.sha256(data).hexdigest() != blob.sha256:
        raise BlobDamaged(f"the {blob.kind} {blob.sha256[:12]} is damaged")
    return data
