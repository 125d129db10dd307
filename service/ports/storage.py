"""Storage as the use cases use it: transactions and blobs from the event loop, and resources by their key."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from contextvars import copy_context
from dataclasses import dataclass
from typing import Generic, TypeVar

from revisit.core.errors import DataLoss
from revisit.service.domain.errors import (
    AlreadyExists,
    BlobCollected,
    NotFound,
    NotKept,
    NotReady,
    SessionFinished,
    StillDeleting,
    StorageUncertain,
)
from revisit.service.domain.identity import SessionKey, SubmapKey, TenantId
from revisit.service.domain.records import JobRecord, MapRecord, RobotRecord, SessionRecord, SubmapRecord
from revisit.service.domain.states import SessionState, SubmapState
from revisit.service.ports.blobs import BlobStore, StoredBlob
from revisit.service.ports.transactions import Transactions, UnitOfWork

T = TypeVar("T")


@dataclass(frozen=True)
class Storage:
    """The database and the blob store of the service."""

    transactions: Transactions
    blobs: BlobStore

    async def write(self, work: Callable[[UnitOfWork], T], *, durable: bool = True) -> T:
        """Commit `work` (see `Transactions.write`). A caller that is cancelled does not undo it."""
        # The writer has a thread of its own: the request's context goes there with the work.
        context = copy_context()
        return await _outcome(self.transactions.write(lambda uow: context.run(work, uow), durable=durable))

    async def read(self, work: Callable[[UnitOfWork], T]) -> T:
        """Run `work` on a snapshot."""
        return await _outcome(self.transactions.read(work))

    async def put_blob(self, tenant: TenantId, kind: str, data: bytes) -> str:
        """Store a blob durably, in a thread; its SHA-256. Raises StorageFull, StorageUncertain."""
        return await asyncio.to_thread(self.blobs.put, tenant, kind, data)

    async def write_naming(self, work: Callable[[UnitOfWork], T], put: Callable[[], object]) -> T:
        """See `write_naming`, on the event loop; `put` runs in a thread."""
        naming = Naming(work)
        for pause_s in PAUSES_S:
            try:
                return await self.write(naming)
            except BlobCollected as collected:
                naming = naming.after(collected)
                await asyncio.sleep(pause_s if collected.pending else 0.0)
            await asyncio.to_thread(put)
        return await self.write(naming)


def discard(blobs: BlobStore, *unnamed: StoredBlob) -> None:
    """Delete blobs that no row names and nobody needs any more; where their store fails, a sweep finds them."""
    with suppress(StorageUncertain):
        blobs.delete(unnamed)


@dataclass(frozen=True)
class Naming(Generic[T]):
    """Work whose rows name blobs (it calls `uow.blobs.refer`), and the collections after which they were put again."""

    work: Callable[[UnitOfWork], T]
    gone: frozenset[int] = frozenset()

    def __call__(self, uow: UnitOfWork) -> T:
        """Do it, in one transaction."""
        uow.blobs.put_again(self.gone)
        return self.work(uow)

    def after(self, collected: BlobCollected) -> Naming[T]:
        """The same work, once the blobs that it found gone were put again."""
        return Naming(self.work, self.gone | collected.gone)


PAUSES_S = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Waits for a collection to delete a blob that was found again meanwhile."""


def write_naming(transactions: Transactions, work: Callable[[UnitOfWork], T], put: Callable[[], object]) -> T:
    """Commit `work`, whose rows name blobs that were put before; `put` puts them again where they were deleted since.

    Raises StorageFull, StorageUncertain, the errors of `work`, and BlobCollected where it goes on for too long.
    """
    naming = Naming(work)
    for pause_s in PAUSES_S:
        try:
            return transactions.write(naming).result()
        except BlobCollected as collected:
            naming = naming.after(collected)
            time.sleep(pause_s if collected.pending else 0.0)
        put()
    return transactions.write(naming).result()


async def _outcome(future: Future[T]) -> T:
    return await asyncio.shield(asyncio.wrap_future(future))


def require_map(uow: UnitOfWork, tenant: TenantId, map_id: str, *, hold: bool = False) -> MapRecord:
    """The map, held where it is to change. Raises NotFound."""
    record = uow.maps.get(tenant, map_id, hold=hold)
    if record is None:
        raise NotFound(f"there is no map {map_id!r}"[:200])
    return record


def require_robot(uow: UnitOfWork, tenant: TenantId, robot_id: str) -> RobotRecord:
    """The robot. Raises NotFound."""
    record = uow.robots.get(tenant, robot_id)
    if record is None:
        raise NotFound(f"there is no robot {robot_id!r}"[:200])
    return record


def require_session(uow: UnitOfWork, tenant: TenantId, key: SessionKey, *, hold: bool = False) -> SessionRecord:
    """The session, held where it is to change. Raises NotFound."""
    record = uow.sessions.get(tenant, key.map_id, key.session_id, hold=hold)
    if record is None:
        raise NotFound(f"there is no session {key.name!r}"[:300])
    return record


def require_deleted(uow: UnitOfWork, tenant: TenantId, map_id: str, session_id: str = "") -> None:
    """Raises StillDeleting while rows are there of a map, or of a session of it, that was deleted."""
    if uow.deletions.get(tenant, map_id, session_id) is not None:
        name = SessionKey(map_id, session_id).name if session_id else f"maps/{map_id}"
        raise StillDeleting(f"what was {name} is being deleted; its id is free again soon"[:300])


def require_active(session: SessionRecord) -> None:
    """Raises SessionFinished unless the session takes data."""
    if session.state != SessionState.ACTIVE:
        raise SessionFinished(f"session {session.session_id} is finished")


def require_submap(uow: UnitOfWork, tenant: TenantId, key: SubmapKey) -> SubmapRecord:
    """The submap. Raises NotFound."""
    record = uow.submaps.get(tenant, key.map_id, key.session_id, key.submap_id)
    if record is None:
        raise NotFound(f"there is no submap {key.name!r}"[:300])
    return record


def require_descriptor(record: SubmapRecord) -> bytes:
    """The descriptor of a submap.

    Raises NotReady before it is described; NotKept where it is retired; DataLoss where it is damaged.
    """
    if record.descriptor is None:
        if record.state == SubmapState.RETIRED:
            raise NotKept(f"submap {record.submap_id} is retired: its map keeps the best submaps of a place")
        if record.state == SubmapState.DESCRIBED:
            name = SubmapKey(record.map_id, record.session_id, record.submap_id).name
            raise DataLoss(f"the descriptor of {name} is damaged; delete the submap and post it again"[:300])
        raise NotReady
    return record.descriptor


def require_job(uow: UnitOfWork, tenant: TenantId, operation_id: str, *, hold: bool = False) -> JobRecord:
    """The job behind an operation, held where it is to change. Raises NotFound."""
    record = uow.jobs.get(tenant, operation_id, hold=hold)
    if record is None:
        raise NotFound(f"there is no operation {operation_id!r}"[:200])
    return record


def require_same_content(known: str, sent: str, name: str) -> None:
    """Raises AlreadyExists where the hash of the content stored under a name differs from that of the new one."""
    if known != sent:
        raise AlreadyExists(f"{name} exists with other content")
