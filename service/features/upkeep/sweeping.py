"""Sweeping: deletes blobs without a row, left behind where a process ended between storing the two."""

from __future__ import annotations

import asyncio
from itertools import groupby, islice

import structlog

from revisit.service.domain.identity import TenantId
from revisit.service.features.deletion.blob_references import (
    BLOBS_PER_TURN,
    Blob,
    BlobCollector,
    unreferenced,
)
from revisit.service.ports.blobs import StoredBlob
from revisit.service.ports.storage import Storage

MIN_AGE_S = 3600.0
"""A blob is stored moments before the row that names it; a younger one may still wait for its row."""

log = structlog.get_logger(__name__)


async def sweep(storage: Storage, min_age_s: float = MIN_AGE_S) -> int:
    """Delete every blob of every tenant that is old enough and that no row names; how many were found."""
    stored = storage.blobs.stored(min_age_s)
    found = 0
    while turn := await asyncio.to_thread(lambda: list(islice(stored, BLOBS_PER_TURN))):
        for tenant, blobs in groupby(turn, key=lambda blob: blob.tenant):
            found += await _sweep_turn(storage, tenant, list(blobs))
    if found:
        log.info("blobs_swept", blobs=found)
    return found


async def _sweep_turn(storage: Storage, tenant: TenantId, blobs: list[StoredBlob]) -> int:
    addresses: list[Blob] = [(blob.kind, blob.sha256) for blob in blobs]
    orphans = await storage.read(lambda uow: unreferenced(uow, tenant, addresses))
    # Looks again, alone in a write transaction: a row may name one of them by now.
    await BlobCollector(storage).collect(tenant, orphans)
    return len(orphans)
