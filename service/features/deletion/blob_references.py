"""Which blobs the rows of a resource name, and deleting what was made of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress

from revisit.core.codec.map_layout import MapLayout
from revisit.core.errors import DataLoss
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import MapFileRecord, MapTileRecord, PlanRecord, ScanRecord, SubmapRecord
from revisit.service.ports.blobs import (
    CLOUD_BLOB,
    MAP_LAYOUT_BLOB,
    NEURAL_MAP_BLOB,
    PLACE_BLOB,
    PLAN_BLOB,
    TILE_BLOB,
    Blob,
)
from revisit.service.ports.transactions import UnitOfWork

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


def blobs_of_scans(scans: Iterable[ScanRecord]) -> set[Blob]:
    """The blobs of scans' clouds; of one whose cloud was removed there is none."""
    return {(CLOUD_BLOB, scan.cloud_sha256) for scan in scans if scan.cloud_sha256}


def blob_of_tile(record: MapTileRecord) -> Blob:
    """The blob of a tile of a map."""
    return TILE_BLOB, record.tile_sha256


def blob_of_file(record: MapFileRecord) -> Blob:
    """The blob with the layout of a map file's bytes."""
    return MAP_LAYOUT_BLOB, record.layout_sha256


def blob_of_plan(record: PlanRecord) -> Blob:
    """The blob of the picture of a plan."""
    return PLAN_BLOB, record.image_sha256


def forget_made(uow: UnitOfWork, tenant: TenantId, map_id: str, session_id: str) -> None:
    """Delete the tiles and files that were made of a session, before a part of it goes."""
    for version in uow.session_poses.distinct(tenant, "version", map_id=map_id, session_id=session_id):
        forget_tiles(uow, tenant, map_id, version)
    for file in uow.map_files.find(tenant, map_id=map_id):
        if session_id in file.sessions:
            forget_file(uow, file)


def forget_tiles(uow: UnitOfWork, tenant: TenantId, map_id: str, version: int) -> None:
    """Delete the tiles of a version of a map, and what was found changed in it."""
    tiles: dict[str, str | int] = {"map_id": map_id, "version": version}
    made = uow.map_tiles.distinct(tenant, "tile_sha256", **tiles)
    uow.blobs.release(tenant, {(TILE_BLOB, sha256) for sha256 in made})
    uow.map_tiles.delete(tenant, **tiles)


def forget_file(uow: UnitOfWork, file: MapFileRecord) -> None:
    """Delete the file of a version of a map."""
    tenant = TenantId(file.tenant)
    uow.map_files.delete(tenant, number=file.number)
    uow.blobs.release(tenant, {blob_of_file(file)})


def forget_plan(uow: UnitOfWork, plan: PlanRecord) -> None:
    """Delete a plan with its picture."""
    tenant = TenantId(plan.tenant)
    uow.plans.delete(tenant, number=plan.number)
    uow.blobs.release(tenant, {blob_of_plan(plan)})


def filed_maps(files: Iterable[MapFileRecord], read: Callable[[TenantId, str, str], bytes]) -> set[str]:
    """The hashes of the neural maps that map files name; `read` gets a blob of a tenant by kind and hash. Blocks.

    A file whose layout is damaged or gone cannot be served: it names none.
    """
    named = set[str]()
    for file in files:
        with suppress(DataLoss):
            named |= MapLayout.from_blob(read(TenantId(file.tenant), *blob_of_file(file))).neural_maps
    return named


def naming(uow: UnitOfWork, tenant: TenantId, blob: Blob) -> int:
    """How many rows of scans and submaps name a blob of theirs."""
    kind, sha256 = blob
    submaps = uow.submaps.count(tenant, **{FIELDS[kind]: sha256})
    return submaps + (uow.scans.count(tenant, cloud_sha256=sha256) if kind == CLOUD_BLOB else 0)
