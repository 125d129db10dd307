"""Which blobs rows refer to, and forgetting those that no row refers to any more."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from revisit.service.application.contract.context import Context
from revisit.service.application.contract.identity import TenantId
from revisit.service.application.contract.ports import BlobStore, UnitOfWork
from revisit.service.application.contract.records import SubmapRecord
from revisit.service.application.ingest.clouds import CLOUD_BLOB, QUERY_CLOUD_BLOB
from revisit.service.application.recognise.meshes import MESH_BLOB
from revisit.service.failpoints import failpoint

SIGNATURE_BLOB = "signature"
NEURAL_MAP_BLOB = "neural-map"

Blob = tuple[str, str]
"""(kind, sha256)."""

BLOBS_PER_TURN = 200
"""A large map has a million blobs: robots and workers, who wait for the one writer, get their turn in between."""


FIELDS = {
    CLOUD_BLOB: "cloud_sha256",
    SIGNATURE_BLOB: "signature_sha256",
    NEURAL_MAP_BLOB: "neural_map_sha256",
    MESH_BLOB: "mesh_sha256",
}
"""Where a submap's row names its blob of a kind."""


def blobs_of_submap(record: SubmapRecord) -> set[Blob]:
    """The blobs that a submap's row names itself; the clouds of its scans belong to the scans."""
    named = ((kind, getattr(record, field)) for kind, field in FIELDS.items())
    return {(kind, sha256) for kind, sha256 in named if sha256 is not None}


def blobs_of_rows(uow: UnitOfWork, tenant: TenantId, **equals: str) -> set[Blob]:
    """The blobs that scans and submaps name whose fields equal `equals`."""
    named = {(CLOUD_BLOB, sha256) for sha256 in uow.scans.distinct(tenant, FIELDS[CLOUD_BLOB], **equals)}
    for kind, field in FIELDS.items():
        named |= {(kind, sha256) for sha256 in uow.submaps.distinct(tenant, field, **equals)}
    return named


async def collect_blobs_in_turns(context: Context, tenant: TenantId, doomed: Iterable[Blob]) -> None:
    """`collect_blobs` of all of `doomed`, in as many short transactions as that takes."""
    left = sorted(doomed)
    for start in range(0, len(left), BLOBS_PER_TURN):
        turn = left[start : start + BLOBS_PER_TURN]
        await context.write(partial(collect_blobs, blobs=context.blobs, tenant=tenant, doomed=turn), alone=True)


def collect_blobs(uow: UnitOfWork, blobs: BlobStore, tenant: TenantId, doomed: Iterable[Blob]) -> None:
    """Delete those of `doomed` that no row refers to.

    Runs alone in a write transaction, after the rows are gone for good, for a file does not come back with a rollback.
    Whoever is about to refer to such a blob makes sure of it in a write transaction too, so either that sees it missing
    or this sees the reference.
    """
    for kind, sha256 in doomed:
        if not is_referenced(uow, tenant, kind, sha256):
            blobs.delete(tenant, kind, sha256)
            failpoint("delete.after_blob")


def is_referenced(uow: UnitOfWork, tenant: TenantId, kind: str, sha256: str) -> bool:
    """Whether a row names the blob. No row names the cloud of a query: who asked deletes it with the answer."""
    if kind == CLOUD_BLOB:
        return bool(uow.submaps.count(tenant, cloud_sha256=sha256) or uow.scans.count(tenant, cloud_sha256=sha256))
    if kind == QUERY_CLOUD_BLOB:
        return False
    # A kind that this version does not know is another version's: it stays.
    return kind not in FIELDS or uow.submaps.count(tenant, **{FIELDS[kind]: sha256}) > 0
