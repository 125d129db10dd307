"""Blobs: bytes that are too large for a row, named by their content."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from revisit.service.domain.identity import TenantId

CLOUD_BLOB = "cloud"
QUERY_CLOUD_BLOB = "query-cloud"
PLACE_BLOB = "signature"
"""The place of a submap for verification, under its name in stores of version 0.1."""
NEURAL_MAP_BLOB = "neural-map"
MESH_BLOB = "mesh"
"""A file of a mesh on its way from the worker to the asking process, which deletes it: no row names it."""
MERGE_PORTION_BLOB = "merge-portion"
"""The verdicts of a merge so far, for its next run: the progress of its job names them, and no row."""
TILE_BLOB = "map-tile"
"""The fused surface of a tile of a map (see `core.codec.tile`)."""
MAP_LAYOUT_BLOB = "map-layout"
"""The layout of a map file's bytes (see `mapping.map_layout`)."""
PLAN_BLOB = "plan"
"""The picture of a plan as it was sent."""


Blob = tuple[str, str]
"""(kind, sha256) of a blob of a tenant."""


@dataclass(frozen=True)
class StoredBlob:
    """The address of a blob."""

    tenant: TenantId
    kind: str
    sha256: str


@dataclass(frozen=True)
class BlobCollection:
    """Blobs to be deleted, by number; `begun_ms` is of the store's clock."""

    begun_ms: int
    blobs: dict[int, StoredBlob]


MOST_MS = 10_000
"""Longest time in which a collection deletes its blobs."""

REMEMBERED_MS = 3_600_000
"""Time for which an ended collection is remembered: longer than any writer takes from storing a blob to naming it."""


class BlobReferences(Protocol):
    """The blobs that rows name, in the transaction of those rows.

    Whoever names a blob puts it first and then says so in the transaction of the row: `Storage.write_naming`.
    """

    def refer(self, tenant: TenantId, blobs: Collection[Blob]) -> None:
        """Rows of this transaction name these blobs, which were put before it.

        Raises BlobCollected where one of them may have been deleted since.
        """
        ...

    def put_again(self, gone: Collection[int]) -> None:
        """The blobs of these collections were put once more after they were gone: `refer` takes them."""
        ...

    def release(self, tenant: TenantId, blobs: Collection[Blob]) -> None:
        """Rows of this transaction named these blobs and are gone, so other rows name them or none."""
        ...

    def strays(self, tenant: TenantId, blobs: Collection[Blob]) -> set[Blob]:
        """Those of these blobs that no row names and no collection knows; none of a kind of another version."""
        ...


class BlobCollections(Protocol):
    """The collection of blobs that no row names any more, in two transactions; the bytes go between them."""

    def begin(self, unreferenced_ms: int, limit: int) -> BlobCollection:
        """Collect at most `limit` blobs that no row has named for `unreferenced_ms`: from this commit on no row can.

        Those of a collection that was begun long ago and not ended come again. Within `MOST_MS` of this call they may
        be deleted, afterwards not any more.
        """
        ...

    def end(self, collection: BlobCollection, numbers: Collection[int]) -> None:
        """Of the blobs of a collection these are deleted."""
        ...


class BlobRows(BlobReferences, BlobCollections, Protocol):
    """References to blobs and their collection."""


class BlobStore(Protocol):
    """Bytes by content, per tenant and kind. A blob survives a power cut once `put` has returned.

    No unit of work calls it: a transaction may be undone, or run again.
    """

    def put(self, tenant: TenantId, kind: str, data: bytes) -> str:
        """Store durably; the SHA-256 (hex). Again: no effect. Raises StorageFull, StorageUncertain."""
        ...

    def get(self, tenant: TenantId, kind: str, sha256: str) -> bytes:
        """The bytes, checked against their hash. Raises DataLoss where they are damaged or missing."""
        ...

    def exists(self, tenant: TenantId, kind: str, sha256: str) -> bool:
        """Whether the blob is there (its content is not checked)."""
        ...

    def disk_bytes(self, tenant: TenantId, kind: str, sha256: str) -> int:
        """What the blob takes of the store's room, as `du` counts it; 0 where there is none."""
        ...

    def delete(self, blobs: Collection[StoredBlob]) -> None:
        """Forget the blobs; those that are not there are none the less gone. Raises StorageUncertain."""
        ...

    def stored(self, older_than_s: float) -> Iterator[StoredBlob]:
        """Every blob of every tenant that was stored at least so long ago."""
        ...

    def quarantined(self) -> int:
        """How many damaged blobs were found and put aside; nothing of them is served."""
        ...


@runtime_checkable
class BlobOutage(Protocol):
    """Whether the store of blobs answers, for those who would begin work that needs it."""

    def unreachable(self) -> str:
        """Why the last call of the store failed, in words of its operator; empty where it did not. Does not wait.

        The store is asked beside, at most once a second, whether it answers again.
        """
        ...


class NoOutage:
    """`BlobOutage` of a store in this machine: its failures end the process, or are those of the disk."""

    def unreachable(self) -> str:
        """See `BlobOutage`."""
        return ""
