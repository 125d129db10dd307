"""Storage as the use cases use it: transactions and blobs from the event loop, and resources by their key."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from contextvars import copy_context
from dataclasses import dataclass
from typing import TypeVar

from revisit.core.errors import DataLoss
from revisit.service.domain.errors import (
    AlreadyExists,
    NotFound,
    NotReady,
    SessionFinished,
    StillDeleting,
)
from revisit.service.domain.identity import SessionKey, SubmapKey, TenantId
from revisit.service.domain.records import JobRecord, MapRecord, RobotRecord, SessionRecord, SubmapRecord
from revisit.service.domain.states import SessionState, SubmapState
from revisit.service.ports.blobs import BlobStore
from revisit.service.ports.transactions import Transactions, UnitOfWork

T = TypeVar("T")


@dataclass(frozen=True)
class Storage:
    """The database and the blob store of the service."""

    transactions: Transactions
    blobs: BlobStore

    async def write(self, work: Callable[[UnitOfWork], T], *, alone: bool = False, durable: bool = True) -> T:
        """Commit `work` (see `Transactions.write`). A caller that is cancelled does not undo it."""
        # The writer has a thread of its own: the request's context goes there with the work.
        context = copy_context()
        return await _outcome(self.transactions.write(lambda uow: context.run(work, uow), alone=alone, durable=durable))

    async def read(self, work: Callable[[UnitOfWork], T]) -> T:
        """Run `work` on a snapshot."""
        return await _outcome(self.transactions.read(work))

    async def put_blob(self, tenant: TenantId, kind: str, data: bytes) -> str:
        """Store a blob durably, in a thread; its SHA-256. Raises StorageFull, StorageUncertain."""
        return await asyncio.to_thread(self.blobs.put, tenant, kind, data)

    def keep_blob(self, tenant: TenantId, kind: str, data: bytes, sha256: str) -> None:
        """Store a blob again where it is missing, inside the write transaction of the row that names it.

        It was stored before that transaction began, and a delete may have collected the same content meanwhile (see
        `catalogue.blob_references`).
        """
        if not self.blobs.exists(tenant, kind, sha256):
            self.blobs.put(tenant, kind, data)


async def _outcome(future: Future[T]) -> T:
    return await asyncio.shield(asyncio.wrap_future(future))


def require_map(uow: UnitOfWork, tenant: TenantId, map_id: str) -> MapRecord:
    """The map. Raises NotFound."""
    record = uow.maps.get(tenant, map_id)
    if record is None:
        raise NotFound(f"there is no map {map_id!r}"[:200])
    return record


def require_robot(uow: UnitOfWork, tenant: TenantId, robot_id: str) -> RobotRecord:
    """The robot. Raises NotFound."""
    record = uow.robots.get(tenant, robot_id)
    if record is None:
        raise NotFound(f"there is no robot {robot_id!r}"[:200])
    return record


def require_session(uow: UnitOfWork, tenant: TenantId, key: SessionKey) -> SessionRecord:
    """The session. Raises NotFound."""
    record = uow.sessions.get(tenant, key.map_id, key.session_id)
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
    """The descriptor of a submap. Raises NotReady before it is described; DataLoss where it is damaged."""
    if record.descriptor is None:
        if record.state == SubmapState.DESCRIBED:
            name = SubmapKey(record.map_id, record.session_id, record.submap_id).name
            raise DataLoss(f"the descriptor of {name} is damaged; delete the submap and post it again"[:300])
        raise NotReady
    return record.descriptor


def require_job(uow: UnitOfWork, tenant: TenantId, operation_id: str) -> JobRecord:
    """The job behind an operation. Raises NotFound."""
    record = uow.jobs.get(tenant, operation_id)
    if record is None:
        raise NotFound(f"there is no operation {operation_id!r}"[:200])
    return record


def require_same_content(known: str, sent: str, name: str) -> None:
    """Raises AlreadyExists where the hash of the content stored under a name differs from that of the new one."""
    if known != sent:
        raise AlreadyExists(f"{name} exists with other content")
