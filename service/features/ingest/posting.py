"""Posting a submap: one cloud, stored durably and queued for its description."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from revisit.core.errors import BadField
from revisit.core.geometry.se3 import Matrix4, pose_row, position_row
from revisit.core.point_columns import INTENSITY
from revisit.core.scan import MAX_SCENE_M, CloudReport, Scan, scene_size
from revisit.service.capacity.backlog import JobPosting
from revisit.service.domain import limits
from revisit.service.domain.identity import (
    RESERVED_SUBMAP_PREFIX,
    SessionKey,
    SubmapKey,
    TenantId,
    content_hash,
    validated_id,
)
from revisit.service.domain.records import JobRecord, SessionRecord, SubmapRecord
from revisit.service.domain.states import OperationKind, SubmapState
from revisit.service.failpoints import failpoint
from revisit.service.features.ingest.clouds import (
    CloudDecoder,
    CloudInput,
    StoredCloud,
    accept_cloud,
    pack_cloud,
    reading_points,
)
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.views import SubmapView
from revisit.service.ports.blobs import CLOUD_BLOB
from revisit.service.ports.storage import (
    Storage,
    require_active,
    require_job,
    require_same_content,
    require_session,
)
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class PostSubmap:
    """One cloud in its sensor frame, seen from `T_odom_submap` (4, 4) in the session's odometry frame."""

    key: SubmapKey
    T_odom_submap: Matrix4
    stamp_ns: int
    cloud: CloudInput


@dataclass(frozen=True)
class PostedSubmap:
    """A durable submap and the operation that describes it. `report` is None on a replay."""

    submap: SubmapView
    operation: JobRecord
    replay: bool
    report: CloudReport | None


@dataclass(frozen=True)
class _Accepted:
    """A posted submap that passed validation: its row but for ordinal and operation, and its cloud to store."""

    row: SubmapRecord
    packed: bytes
    report: CloudReport


class SubmapPosting:
    """Posts submaps."""

    def __init__(self, context: CallContext, decoder: CloudDecoder) -> None:
        """`decoder` reads clouds beside the event loop."""
        self._context = context
        self._decoder = decoder

    async def post(self, tenant: TenantId, command: PostSubmap) -> PostedSubmap:
        """Store a submap durably and queue its description; returns after the commit.

        Raises the errors of decoding and validation, BadField, BadTransform, NotFound for the session, SessionFinished,
        AlreadyExists for other content under the same id, WorkersBusy, RateLimited, QuotaReached, Draining,
        StorageFull, StorageUncertain.
        """
        self._context.admission.require_storage()
        async with self._context.admission.cloud(tenant, refused_points=reading_points(command.cloud)) as decoded:
            return await self._store(tenant, command, decoded)

    async def _store(self, tenant: TenantId, command: PostSubmap, decoded: Callable[[int], None]) -> PostedSubmap:
        accepted = await self._decoder.run(tenant, _accept, tenant, command, self._context.clock.wall_ns())
        decoded(accepted.row.point_count)
        replay = await self._context.storage.read(partial(_replayed, row=accepted.row))
        if replay is not None:
            return replay
        # The cloud may have waited for its turn to be decoded.
        self._context.admission.require_storage()
        await self._context.admission.require_room(tenant)
        put = partial(self._context.storage.blobs.put, tenant, CLOUD_BLOB, accepted.packed)
        await asyncio.to_thread(put)
        failpoint("ingest.after_blob")
        posted = await self._context.storage.write_naming(partial(self._insert, accepted=accepted), put)
        self._context.admission.note_stored(tenant, accepted.row.point_count)
        failpoint("ingest.after_commit")
        return await with_seq(self._context.storage, tenant, posted)

    def _insert(self, uow: UnitOfWork, accepted: _Accepted) -> PostedSubmap:
        row = accepted.row
        session = require_session(uow, row.tenant, SessionKey(row.map_id, row.session_id), hold=True)
        replay = _replayed(uow, row)
        if replay is not None:
            return replay
        uow.blobs.refer(row.tenant, [(CLOUD_BLOB, str(row.cloud_sha256))])
        added, _ = add_submap(uow, self._context.jobs, session, row)
        return posted_submap(uow, added, replay=False, report=accepted.report)


def add_submap(
    uow: UnitOfWork, jobs: JobPosting, session: SessionRecord, row: SubmapRecord
) -> tuple[SubmapRecord, SessionRecord]:
    """Add a submap's row and the job that describes it, in one transaction; the rows as stored. Raises WorkersBusy."""
    key = SubmapKey(row.map_id, row.session_id, row.submap_id)
    payload = {"map_id": key.map_id, "session_id": key.session_id, "submap_id": key.submap_id}
    job = jobs.post(uow, row.tenant, OperationKind.DESCRIBE_SUBMAP, key.name, payload)
    placed = replace(row, ordinal=session.next_ordinal, session_number=session.number, operation_id=job.operation_id)
    counted = replace(session, next_ordinal=session.next_ordinal + 1)
    uow.sessions.replace(counted)
    return uow.submaps.add(placed), counted


def posted_submap(uow: UnitOfWork, record: SubmapRecord, *, replay: bool, report: CloudReport | None) -> PostedSubmap:
    """The answer to a post. Raises NotFound where the operation's record is gone."""
    job = require_job(uow, record.tenant, record.operation_id)
    return PostedSubmap(SubmapView.of(record), job, replay, report)


async def with_seq(storage: Storage, tenant: TenantId, posted: PostedSubmap) -> PostedSubmap:
    """The answer to a post that is committed: its submap has got its number within the map with that."""
    number = posted.submap.number
    stored = await storage.read(lambda uow: uow.submaps.numbered(tenant, [number]))
    return replace(posted, submap=SubmapView.of(stored.get(number, posted.submap)))


def _replayed(uow: UnitOfWork, row: SubmapRecord) -> PostedSubmap | None:
    """The first answer, where it was posted before. Raises AlreadyExists, NotFound, SessionFinished."""
    session = require_session(uow, row.tenant, SessionKey(row.map_id, row.session_id))
    known = uow.submaps.get(row.tenant, row.map_id, row.session_id, row.submap_id)
    if known is None:
        require_active(session)
        return None
    require_same_content(known.content_hash, row.content_hash, f"submap {row.submap_id}")
    return posted_submap(uow, known, replay=True, report=None)


def _accept(tenant: TenantId, command: PostSubmap, now_ns: int) -> _Accepted:
    _validate_key(command.key)
    cloud, report = accept_cloud(command.cloud, limits.SUBMAP_POINTS)
    scan = Scan.posed(cloud.points, report, command.T_odom_submap, command.stamp_ns)
    packed = pack_cloud(cloud)
    return _Accepted(_row(tenant, command.key, scan, cloud, packed, report, now_ns), packed, report)


def _validate_key(key: SubmapKey) -> None:
    validated_id(key.submap_id, "submap_id")
    if key.submap_id.startswith(RESERVED_SUBMAP_PREFIX):
        raise BadField(f"submap_id must not begin with {RESERVED_SUBMAP_PREFIX!r}", field="submap_id")


def _row(
    tenant: TenantId, key: SubmapKey, scan: Scan, cloud: StoredCloud, packed: bytes, report: CloudReport, now_ns: int
) -> SubmapRecord:
    pose = np.ascontiguousarray(scan.T_odom_sensor, dtype="<f8")
    columns = {name: values.tobytes() for name, values in cloud.columns.items()}
    content = (pose.tobytes(), scan.stamp_ns, cloud.points.tobytes(), columns.pop(INTENSITY.name, None))
    return SubmapRecord(
        tenant=tenant,
        map_id=key.map_id,
        session_id=key.session_id,
        submap_id=key.submap_id,
        content_hash=content_hash((*content, *(part for one in columns.items() for part in one))),
        state=SubmapState.QUEUED.value,
        ordinal=0,
        session_number=0,
        T_odom_submap=pose_row(scan.T_odom_sensor),
        position_m=position_row(scan.T_odom_sensor[:3, 3]),
        stamp_ns=scan.stamp_ns,
        cloud_sha256=hashlib.sha256(packed).hexdigest(),
        first_seq=None,
        last_seq=None,
        scan_count=1,
        point_count=len(cloud.points),
        operation_id="",
        flags=("degenerate_plane",) * report.degenerate_plane + ("scene_too_large",) * (scene_size(scan) > MAX_SCENE_M),
        created_at_ns=now_ns,
    )
