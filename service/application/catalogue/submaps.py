"""Submaps: what a robot saw over a few metres of travel; posted as one cloud, or cut from a stream of scans."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry.se3 import Matrix4
from revisit.core.scan import CloudReport, Scan
from revisit.service.application.access import audit
from revisit.service.application.catalogue.deletion import delete_submap
from revisit.service.application.catalogue.maps import require_map
from revisit.service.application.catalogue.paging import Page, PageRequest, page_of
from revisit.service.application.catalogue.session_lookup import require_active, require_session
from revisit.service.application.contract import limits
from revisit.service.application.contract.context import Context
from revisit.service.application.contract.errors import AlreadyExists, NotFound
from revisit.service.application.contract.identity import (
    RESERVED_SUBMAP_PREFIX,
    SessionKey,
    SubmapKey,
    TenantId,
    content_hash,
    validated_id,
)
from revisit.service.application.contract.ports import UnitOfWork
from revisit.service.application.contract.poses import pose_matrix, pose_row, position_row
from revisit.service.application.contract.records import SessionRecord, SubmapRecord, SubmapState
from revisit.service.application.housekeeping.blob_references import Blob, collect_blobs_in_turns
from revisit.service.application.ingest.clouds import (
    CLOUD_BLOB,
    CloudInput,
    StoredCloud,
    accept_cloud,
    pack_cloud,
)
from revisit.service.application.ingest.submap_source import SubmapSource, submap_source
from revisit.service.application.query.downloads import Download, DownloadKind, render_download
from revisit.service.application.query.operations import (
    OperationFailure,
    OperationKind,
    OperationView,
    failure_of,
    new_job,
    operation_view,
)
from revisit.service.failpoints import failpoint


@dataclass(frozen=True)
class PostSubmap:
    """One cloud in its sensor frame, seen from `T_odom_submap` (4, 4) in the session's odometry frame."""

    key: SubmapKey
    T_odom_submap: Matrix4
    stamp_ns: int
    cloud: CloudInput


@dataclass(frozen=True)
class SubmapView:
    """A submap as clients see it.

    `ordinal` counts the submaps of its session from 0; `position_m` is where it was taken, in the session's odometry
    frame; `first_seq`..`last_seq` are its scans (None for a posted cloud); `raw_bytes` is the float32 xyz cloud's
    size, `neural_map_bytes` that of its neural map; `failure` says why it could not be described. `descriptor` (d,) is
    there where it was asked for and the submap is described. `seq` grows with every submap of the service, in the order
    of their commits: a query's `min_seq` (see `freshness`).
    """

    key: SubmapKey
    seq: int
    state: SubmapState
    ordinal: int
    T_odom_submap: Matrix4
    position_m: tuple[float, float, float]
    stamp_ns: int
    first_seq: int | None
    last_seq: int | None
    scan_count: int
    point_count: int
    raw_bytes: int
    neural_map_bytes: int | None
    flags: tuple[str, ...]
    model_version: str | None
    failure: OperationFailure | None
    operation_id: str
    created_at_ns: int
    descriptor: NDArray[np.float32] | None = field(default=None, compare=False)


@dataclass(frozen=True)
class PostedSubmap:
    """A durable submap and the operation that describes it. `report` is None on a replay."""

    submap: SubmapView
    operation: OperationView
    replay: bool
    report: CloudReport | None


@dataclass(frozen=True)
class _Accepted:
    """A posted submap that passed validation: its row but for ordinal and operation, and its cloud to store."""

    row: SubmapRecord
    packed: bytes
    report: CloudReport


class Submaps:
    """Post, get, list, delete and download submaps."""

    def __init__(self, context: Context) -> None:
        """All calls use `context`."""
        self._context = context

    async def post(self, tenant: TenantId, command: PostSubmap) -> PostedSubmap:
        """Store a submap durably and queue its description; returns after the commit.

        Raises what decoding and validation raise, BadField, BadTransform, NotFound for the session, SessionFinished,
        AlreadyExists for other content under the same id, WorkersBusy, RateLimited, Draining, StorageFull,
        StorageUncertain.
        """
        self._context.admit_data()
        async with self._context.taking_in(tenant) as spend:
            return await self._store(tenant, command, spend)

    async def _store(self, tenant: TenantId, command: PostSubmap, spend: Callable[[int], None]) -> PostedSubmap:
        accepted = await self._context.decode(self._accept, tenant, command)
        spend(accepted.row.point_count)
        known = await self._context.read(lambda uow: self._known(uow, accepted.row))
        if known is not None:
            return known
        await self._context.compute(self._context.blobs.put, tenant, CLOUD_BLOB, accepted.packed)
        failpoint("ingest.after_blob")
        posted = await self._context.write(lambda uow: self._insert(uow, accepted))
        failpoint("ingest.after_commit")
        return posted

    async def get(self, tenant: TenantId, key: SubmapKey, *, full: bool = False) -> SubmapView:
        """The submap, with its descriptor where `full`. Raises NotFound."""
        record = await self._context.read(lambda uow: require_submap(uow, tenant, key))
        view = submap_view(record)
        if not full or record.descriptor is None:
            return view
        return replace(view, descriptor=np.frombuffer(record.descriptor, dtype="<f4").astype(np.float32))

    async def list(self, tenant: TenantId, session: SessionKey, page: PageRequest) -> Page[SubmapView]:
        """The submaps of a session in their order. Raises NotFound for the session."""

        def load(uow: UnitOfWork) -> list[SubmapRecord]:
            require_session(uow, tenant, session)
            of_session = {"map_id": session.map_id, "session_id": session.session_id}
            return uow.submaps.find(tenant, after=page.after, limit=page.size + 1, **of_session)

        return page_of(await self._context.read(load), page, submap_view)

    async def delete(self, tenant: TenantId, key: SubmapKey) -> None:
        """Delete a submap, its loop closures and its place in the index. Raises NotFound, Draining."""
        self._context.admit()
        entry, at_ns = audit.noted(tenant, "submap_deleted", key.name), self._context.clock.wall_ns()

        def remove(uow: UnitOfWork) -> set[Blob]:
            record = require_submap(uow, tenant, key)
            audit.append(uow, at_ns, entry)
            return delete_submap(uow, require_map(uow, tenant, key.map_id), record, at_ns)

        doomed = await self._context.write(remove)
        failpoint("delete.after_rows")
        await collect_blobs_in_turns(self._context, tenant, doomed)

    async def download(
        self, tenant: TenantId, key: SubmapKey, kind: DownloadKind, file_format: str | None = None
    ) -> Download:
        """The submap as a file. Formats: mesh ply; points pcd, ply or npy; neural and descriptor have one of their own.

        Raises NotFound; NotReady where it is not described yet; UnsupportedEncoding for another format; DataLoss.
        """

        def load(uow: UnitOfWork) -> tuple[SubmapRecord, SubmapSource]:
            record = require_submap(uow, tenant, key)
            return record, submap_source(uow, self._context, record)

        record, source = await self._context.read(load)
        return await self._context.compute(render_download, self._context.blobs, record, source, kind, file_format)

    def _accept(self, tenant: TenantId, command: PostSubmap) -> _Accepted:
        _validate_key(command.key)
        cloud, report = accept_cloud(command.cloud, limits.SUBMAP_POINTS)
        scan = Scan.validated(cloud.points, command.T_odom_submap, command.stamp_ns)
        packed = pack_cloud(cloud)
        return _Accepted(self._row(tenant, command.key, scan, cloud, packed, report), packed, report)

    def _row(
        self, tenant: TenantId, key: SubmapKey, scan: Scan, cloud: StoredCloud, packed: bytes, report: CloudReport
    ) -> SubmapRecord:
        pose = np.ascontiguousarray(scan.T_odom_sensor, dtype="<f8")
        intensity = None if cloud.intensity is None else cloud.intensity.tobytes()
        content = (pose.tobytes(), scan.stamp_ns, cloud.points.tobytes(), intensity)
        return SubmapRecord(
            tenant=tenant,
            map_id=key.map_id,
            session_id=key.session_id,
            submap_id=key.submap_id,
            content_hash=content_hash(content),
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
            flags=("degenerate_plane",) if report.degenerate_plane else (),
            created_at_ns=self._context.clock.wall_ns(),
        )

    def _known(self, uow: UnitOfWork, row: SubmapRecord) -> PostedSubmap | None:
        """The first answer, where it was posted before. Raises AlreadyExists, NotFound, SessionFinished."""
        session = require_session(uow, row.tenant, SessionKey(row.map_id, row.session_id))
        known = uow.submaps.get(row.tenant, row.map_id, row.session_id, row.submap_id)
        if known is None:
            require_active(session)
            return None
        if known.content_hash != row.content_hash:
            raise AlreadyExists(f"submap {row.submap_id} exists with other content")
        return posted_submap(uow, known, replay=True, report=None)

    def _insert(self, uow: UnitOfWork, accepted: _Accepted) -> PostedSubmap:
        row = accepted.row
        known = self._known(uow, row)
        if known is not None:
            return known
        # A delete may have collected the same content meanwhile (see blob_references.collect_blobs).
        if not self._context.blobs.exists(row.tenant, CLOUD_BLOB, str(row.cloud_sha256)):
            self._context.blobs.put(row.tenant, CLOUD_BLOB, accepted.packed)
        session = require_session(uow, row.tenant, SessionKey(row.map_id, row.session_id))
        added, _ = add_submap(uow, self._context, session, row)
        return posted_submap(uow, added, replay=False, report=accepted.report)


def add_submap(
    uow: UnitOfWork, context: Context, session: SessionRecord, row: SubmapRecord
) -> tuple[SubmapRecord, SessionRecord]:
    """Add a submap's row and the job that describes it, in one transaction; the rows as stored. Raises WorkersBusy."""
    context.require_queue_space(uow, row.tenant)
    key = SubmapKey(row.map_id, row.session_id, row.submap_id)
    payload = {"map_id": key.map_id, "session_id": key.session_id, "submap_id": key.submap_id}
    job = uow.queue.enqueue(new_job(context, row.tenant, OperationKind.DESCRIBE_SUBMAP, key.name, payload))
    placed = replace(row, ordinal=session.next_ordinal, session_number=session.number, operation_id=job.operation_id)
    counted = replace(session, next_ordinal=session.next_ordinal + 1)
    uow.sessions.replace(counted)
    return uow.submaps.add(placed), counted


def require_submap(uow: UnitOfWork, tenant: TenantId, key: SubmapKey) -> SubmapRecord:
    """The submap. Raises NotFound."""
    record = uow.submaps.get(tenant, key.map_id, key.session_id, key.submap_id)
    if record is None:
        raise NotFound(f"there is no submap {key.name!r}"[:300])
    return record


def posted_submap(uow: UnitOfWork, record: SubmapRecord, *, replay: bool, report: CloudReport | None) -> PostedSubmap:
    """The answer to a post. Raises NotFound where the operation's record is gone."""
    job = uow.jobs.get(record.tenant, record.operation_id)
    if job is None:
        raise NotFound(f"there is no operation {record.operation_id}")
    return PostedSubmap(submap_view(record), operation_view(job), replay, report)


def submap_key(record: SubmapRecord) -> SubmapKey:
    """The key of a submap's row."""
    return SubmapKey(record.map_id, record.session_id, record.submap_id)


def submap_view(record: SubmapRecord) -> SubmapView:
    """The client's view of a submap."""
    return SubmapView(
        key=submap_key(record),
        seq=record.number,
        state=SubmapState(record.state),
        ordinal=record.ordinal,
        T_odom_submap=pose_matrix(record.T_odom_submap),
        position_m=record.position_m,
        stamp_ns=record.stamp_ns,
        first_seq=record.first_seq,
        last_seq=record.last_seq,
        scan_count=record.scan_count,
        point_count=record.point_count,
        raw_bytes=12 * record.point_count,
        neural_map_bytes=record.neural_map_bytes,
        flags=record.flags,
        model_version=record.model_version,
        failure=failure_of(record.failure_code, record.failure_message),
        operation_id=record.operation_id,
        created_at_ns=record.created_at_ns,
    )


def _validate_key(key: SubmapKey) -> None:
    validated_id(key.submap_id, "submap_id")
    if key.submap_id.startswith(RESERVED_SUBMAP_PREFIX):
        raise BadField(f"submap_id must not begin with {RESERVED_SUBMAP_PREFIX!r}", field="submap_id")


__all__ = [
    "Download",
    "DownloadKind",
    "PostSubmap",
    "PostedSubmap",
    "SubmapView",
    "Submaps",
    "add_submap",
    "posted_submap",
    "require_submap",
    "submap_key",
    "submap_view",
]
