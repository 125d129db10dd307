"""Which blobs the rows refer to, and deleting those that no row refers to any more."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from functools import partial

from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import MapFileRecord, MapTileRecord, ScanRecord, SubmapRecord
from revisit.service.failpoints import failpoint
from revisit.service.ports.blobs import (
    CLOUD_BLOB,
    MAP_LAYOUT_BLOB,
    MESH_BLOB,
    NEURAL_MAP_BLOB,
    PLACE_BLOB,
    QUERY_CLOUD_BLOB,
    TILE_BLOB,
    BlobStore,
)
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork

Blob = tuple[str, str]
"""(kind, sha256)."""

BLOBS_PER_TURN = 200
"""Blobs that are deleted in one transaction: other writers get their turn in between."""


FIELDS = {
    CLOUD_BLOB: "cloud_sha256",
    PLACE_BLOB: "place_sha256",
    NEURAL_MAP_BLOB: "neural_map_sha256",
}
"""Where a submap's row names its blob of a kind."""


def blobs_of_submap(record: SubmapRecord) -> set[Blob]:
    """The blobs that a submap's row names itself; the clouds of its scans belong to the scans."""
    named = ((kind, getattr(record, field)) for kind, field in FIELDS.items())
    return {(kind, sha256) for kind, sha256 in named if sha256 is not None}


def blob_of_scan(record: ScanRecord) -> Blob:
    """The blob of a scan's cloud."""
    return CLOUD_BLOB, record.cloud_sha256


def blob_of_tile(record: MapTileRecord) -> Blob:
    """The blob of a tile of a map."""
    return TILE_BLOB, record.tile_sha256


def blob_of_file(record: MapFileRecord) -> Blob:
    """The blob with the layout of a map file's bytes."""
    return MAP_LAYOUT_BLOB, record.layout_sha256


def forget_made(uow: UnitOfWork, tenant: TenantId, map_id: str, session_id: str) -> set[Blob]:
    """Delete the tiles and files that were made of a session before a part of it goes; their blobs."""
    doomed = set[Blob]()
    for version in uow.session_poses.distinct(tenant, "version", map_id=map_id, session_id=session_id):
        tiles = {"map_id": map_id, "version": version}
        doomed |= {(TILE_BLOB, sha256) for sha256 in uow.map_tiles.distinct(tenant, "tile_sha256", **tiles)}
        uow.map_tiles.delete(tenant, **tiles)
    for file in uow.map_files.find(tenant, map_id=map_id):
        if session_id in file.sessions:
            uow.map_files.delete(tenant, number=file.number)
            doomed.add(blob_of_file(file))
    return doomed


class BlobCollector:
    """Deletes blobs that no row refers to any more."""

    def __init__(self, storage: Storage) -> None:
        """Rows and blobs are those of `storage`."""
        self._storage = storage

    async def collect(self, tenant: TenantId, doomed: Iterable[Blob]) -> None:
        """`collect_blobs` for all of `doomed`, in as many short transactions as needed."""
        left = sorted(doomed)
        for start in range(0, len(left), BLOBS_PER_TURN):
            turn = left[start : start + BLOBS_PER_TURN]
            work = partial(collect_blobs, blobs=self._storage.blobs, tenant=tenant, doomed=turn)
            await self._storage.write(work, alone=True)


def collect_blobs(uow: UnitOfWork, blobs: BlobStore, tenant: TenantId, doomed: Iterable[Blob]) -> None:
    """Delete those of `doomed` that no row refers to.

    Runs alone in a write transaction after the rows were deleted, because a rollback brings no file back. A writer that
    adds a reference to such a blob checks in a write transaction too that the blob is there (`Storage.keep_blob`). So
    either that transaction sees the blob missing, or this one sees the reference.
    """
    for kind, sha256 in sorted(unreferenced(uow, tenant, doomed)):
        blobs.delete(tenant, kind, sha256)
        failpoint("delete.after_blob")


def unreferenced(uow: UnitOfWork, tenant: TenantId, blobs: Iterable[Blob]) -> set[Blob]:
    """Those of these blobs that no row names."""
    by_kind: dict[str, set[str]] = {}
    for kind, sha256 in blobs:
        by_kind.setdefault(kind, set()).add(sha256)
    named = {kind: _named(uow, tenant, kind, hashes) for kind, hashes in by_kind.items()}
    return {(kind, sha256) for kind, hashes in by_kind.items() for sha256 in hashes - named[kind]}


def _named(uow: UnitOfWork, tenant: TenantId, kind: str, hashes: Collection[str]) -> set[str]:
    """Those of these blobs of a kind that a row names.

    No row names the cloud of a query, or a mesh: the asking process deletes it with the answer.
    """
    if kind == CLOUD_BLOB:
        field = FIELDS[CLOUD_BLOB]
        return uow.submaps.named(tenant, field, hashes) | uow.scans.named(tenant, field, hashes)
    if kind in (QUERY_CLOUD_BLOB, MESH_BLOB):
        return set()
    if kind == TILE_BLOB:
        return uow.map_tiles.named(tenant, "tile_sha256", hashes)
    if kind == MAP_LAYOUT_BLOB:
        return uow.map_files.named(tenant, "layout_sha256", hashes)
    # A kind that this version does not know is another version's: it stays.
    return uow.submaps.named(tenant, FIELDS[kind], hashes) if kind in FIELDS else set(hashes)
