"""Blobs in memory."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator

from revisit.core.errors import DataLoss
from revisit.service.domain.identity import TenantId
from revisit.service.ports.blobs import StoredBlob


class MemoryBlobStore:
    """`BlobStore` without a disk."""

    def __init__(self) -> None:
        """Begins empty."""
        self._blobs: dict[tuple[TenantId, str, str], bytes] = {}

    def put(self, tenant: TenantId, kind: str, data: bytes) -> str:
        """See `BlobStore`."""
        sha256 = hashlib.sha256(data).hexdigest()
        self._blobs[tenant, kind, sha256] = data
        return sha256

    def get(self, tenant: TenantId, kind: str, sha256: str) -> bytes:
        """See `BlobStore`."""
        if (tenant, kind, sha256) not in self._blobs:
            raise DataLoss(f"the {kind} {sha256[:12]} is missing")
        return self._blobs[tenant, kind, sha256]

    def exists(self, tenant: TenantId, kind: str, sha256: str) -> bool:
        """See `BlobStore`."""
        return (tenant, kind, sha256) in self._blobs

    def disk_bytes(self, tenant: TenantId, kind: str, sha256: str) -> int:
        """See `BlobStore`."""
        return len(self._blobs.get((tenant, kind, sha256), b""))

    def delete(self, blobs: Collection[StoredBlob]) -> None:
        """See `BlobStore`."""
        for blob in blobs:
            self._blobs.pop((blob.tenant, blob.kind, blob.sha256), None)

    def stored(self, older_than_s: float) -> Iterator[StoredBlob]:
        """See `BlobStore`; ages are not kept, so every blob counts as old enough."""
        return iter([StoredBlob(*address) for address in self._blobs])

    def quarantined(self) -> int:
        """See `BlobStore`; memory is not damaged."""
        return 0
