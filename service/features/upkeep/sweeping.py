"""Collecting blobs: those that no row has named for an hour are deleted.

Rows that go release their blobs in their own transaction. Files that never had a row are found by a sweep, which
lets their hour begin; a process that ended between storing the two has left them behind.
"""

from __future__ import annotations

import asyncio
import time
from functools import partial
from itertools import groupby, islice

import structlog

from revisit.service.domain.identity import TenantId
from revisit.service.failpoints import failpoint
from revisit.service.features.operations.progress import kept_for_jobs
from revisit.service.ports.blobs import MOST_MS, BlobCollection, BlobStore, StoredBlob
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork

UNREFERENCED_S = 3600.0
"""Time for which no row has named a blob before it is deleted, by the store's clock: longer than any transaction."""

BLOBS_PER_TURN = 200
"""Blobs that are looked at, or deleted, at once: other writers get their turn in between."""

BLOBS_AT_ONCE = 20
"""Blobs that one call of the store deletes."""

log = structlog.get_logger(__name__)


async def sweep(storage: Storage, min_age_s: float = UNREFERENCED_S) -> int:
    """Let the hour begin of each old file that no row names; how many there were."""
    stored = storage.blobs.stored(min_age_s)
    found = 0
    while turn := await asyncio.to_thread(lambda: list(islice(stored, BLOBS_PER_TURN))):
        for tenant, blobs in groupby(turn, key=lambda blob: blob.tenant):
            found += await _release_strays(storage, tenant, list(blobs))
    if found:
        log.info("stray_blobs_found", blobs=found)
    return found


async def collect(storage: Storage, unreferenced_s: float = UNREFERENCED_S) -> int:
    """Delete the blobs that no row has named for so long; how many."""
    age_ms, deleted = int(unreferenced_s * 1000), 0
    while True:
        until_s = time.monotonic() + MOST_MS / 1000
        begun = await storage.write(lambda uow: uow.blobs.begin(age_ms, BLOBS_PER_TURN))
        if not begun.blobs:
            break
        gone = await asyncio.to_thread(_deleted, storage.blobs, begun, until_s)
        await storage.write(partial(_end, begun=begun, gone=gone))
        deleted += len(gone)
    if deleted:
        log.info("blobs_collected", blobs=deleted)
    return deleted


async def _release_strays(storage: Storage, tenant: TenantId, blobs: list[StoredBlob]) -> int:
    addresses = [(blob.kind, blob.sha256) for blob in blobs]
    strays = await storage.read(lambda uow: uow.blobs.strays(tenant, addresses) - kept_for_jobs(uow, tenant))
    if strays:
        await storage.write(lambda uow: uow.blobs.release(tenant, strays))
    return len(strays)


def _end(uow: UnitOfWork, begun: BlobCollection, gone: list[int]) -> None:
    uow.blobs.end(begun, gone)


def _deleted(blobs: BlobStore, begun: BlobCollection, until_s: float) -> list[int]:
    """Delete the blobs of a collection up to `until_s` of the monotonic clock; their numbers."""
    left, gone = iter(begun.blobs.items()), list[int]()
    while time.monotonic() <= until_s and (some := dict(islice(left, BLOBS_AT_ONCE))):
        blobs.delete(some.values())
        failpoint("delete.after_blob")
        gone.extend(some)
    return gone
