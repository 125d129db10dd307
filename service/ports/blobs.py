"""Blobs: bytes that are too large for a row, named by their content."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from revisit.service.domain.identity import TenantId

CLOUD_BLOB = "cloud"
QUERY_CLOUD_BLOB = "query-cloud"
PLACE_BLOB = "signature"
"""The place of a submap for verification, under its name in stores of version 0.1."""
NEURAL_MAP_BLOB = "neural-map"
MESH_BLOB = "mesh"
"""A file of a mesh on its way from the worker to the asking process, which deletes it: no row names it."""
TILE_BLOB = "map-tile"
"""The fused surface of a tile of a map (see `core.codec.tile`)."""
MAP_LAYOUT_BLOB = "map-layout"
"""The layout of a map file's bytes (see `mapping.map_layout`)."""


@dataclass(frozen=True)
class StoredBlob:
    """The address of a blob."""

    tenant: TenantId
    kind: str
    sha256: str


class BlobStore(Protocol):
    """Bytes by content, per tenant and kind. A blob survives a power cut once `put` has returned."""

    def put(self, tenant: TenantId, kind: str, data: bytes) -> str:
        """Store durably; the SHA-256 (hex). Again: no effect. Raises StorageFull, StorageUncertain."""
        ...

    def get(self, tenant: TenantId, kind: str, sha256: str) -> bytes:
        """The bytes, checked against their hash. Raises DataLoss where they are damaged or missing."""
        ...

    def exists(self, tenant: TenantId, kind: str, sha256: str) -> bool:
        """Whether the blob is there (its content is not checked)."""
        ...

    def delete(self, tenant: TenantId, kind: str, sha256: str) -> None:
        """Forget the blob; no effect where there is none."""
        ...

    def stored(self, older_than_s: float) -> Iterator[StoredBlob]:
        """Every blob of every tenant that was stored at least so long ago."""
        ...

    def quarantined(self) -> int:
        """How many damaged blobs were found and put aside; nothing of them is served."""
        ...
