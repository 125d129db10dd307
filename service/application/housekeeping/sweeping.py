"""Sweeping: blobs that no row names any more, or never did, because a process ended between the two, are deleted."""

from __future__ import annotations

from itertools import groupby, islice

import structlog

from revisit.service.application.contract.context import Context
from revisit.service.application.contract.identity import TenantId
from revisit.service.application.contract.ports import StoredBlob
from revisit.service.application.housekeeping.blob_references import (
    BLOBS_PER_TURN,
    Blob,
    collect_blobs_in_turns,
    is_referenced,
)

MIN_AGE_S = 3600.0
"""A blob is stored moments before the row that names it; what is younger may still be waiting for its row."""

log = structlog.get_logger(__name__)


async def sweep(context: Context, min_age_s: float = MIN_AGE_S) -> int:
    """Delete every blob of every tenant that is old enough and that no row names; how many were found."""
    stored = context.blobs.stored(min_age_s)
    found = 0
    while turn := await context.compute(lambda: list(islice(stored, BLOBS_PER_TURN))):
        for tenant, blobs in groupby(turn, key=lambda blob: blob.tenant):
            found += await _sweep_turn(context, tenant, list(blobs))
    if found:
        log.info("blobs_swept", blobs=found)
    return found


async def _sweep_turn(context: Context, tenant: TenantId, blobs: list[StoredBlob]) -> int:
    addresses: list[Blob] = [(blob.kind, blob.sha256) for blob in blobs]
    orphans = await context.read(lambda uow: [blob for blob in addresses if not is_referenced(uow, tenant, *blob)])
    # Looks again, alone in a write transaction: a row may name one of them by now.
    await collect_blobs_in_turns(context, tenant, orphans)
    return len(orphans)
