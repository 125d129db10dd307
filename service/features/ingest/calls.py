"""Scans: a stream of posed sweeps that the service cuts into submaps.

A session's row holds the window of scans that the next submap is made of: the state of `core.submap.SubmapBuilder`. The
builder keeps scans in memory; here they are rows, and a window is the range of their sequence numbers, so that an
unfinished one survives a restart. A test holds the two against each other on random drives.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Collection
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.core.point_columns import same
from revisit.core.scan import Scan
from revisit.core.scan_marks import ScanMarks
from revisit.service.capacity.budget import Remembered
from revisit.service.capacity.in_flight import InFlight
from revisit.service.domain import limits
from revisit.service.domain.errors import NotFound, SequenceGap
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import ScanRecord, SessionRecord
from revisit.service.domain.retention import KEEPS_ALL, KeptScans, RetentionPolicy
from revisit.service.failpoints import failpoint
from revisit.service.features.ingest.appending import (
    AcceptedScan,
    Appending,
    ScanAck,
    ScanStream,
    is_replay,
    same_place,
    stored_scan,
    taken,
)
from revisit.service.features.ingest.clouds import (
    CloudDecoder,
    CloudInput,
    accept_cloud,
    pack_cloud,
    reading_points,
    unpack_cloud,
)
from revisit.service.features.ingest.posting import with_seq
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.waiting.shared_poll import SharedPoll
from revisit.service.ports.blobs import CLOUD_BLOB
from revisit.service.ports.storage import require_active, require_map, require_session
from revisit.service.ports.transactions import UnitOfWork

POLICY_HOLDS_MS = 60_000
"""So long a gateway goes by a policy of retention that it has read when a scan came."""

ENDS_WITHIN_S = 1.0
"""An idle stream ends so soon after its session was deleted: one question a tenant for all streams of a gateway."""


@dataclass(frozen=True)
class AppendScan:
    """The scan with client sequence number `seq` (1, 2, 3, ...), taken from `T_odom_sensor` (4, 4), of `stream`.

    `travelled_m`: how far the session had travelled, metres, where the robot counts poses that it does not send.
    """

    session: SessionKey
    seq: int
    stamp_ns: int
    T_odom_sensor: Matrix4
    cloud: CloudInput
    stream: ScanStream | None = None
    travelled_m: float | None = None


@dataclass(frozen=True)
class ResumePoint:
    """A client's memory of a session: the token of an earlier stream, if any, and the last acknowledged scan."""

    token: str = ""
    acknowledged_seq: int = 0


@dataclass(frozen=True)
class OpenedStream:
    """Where a client resumes: the next scan to send is `committed_seq + 1`.

    `resume_token` and `session_number` name this session and no other that may get its name later. `marks` say which
    scans are described; the way is counted on from `travelled_m`, at the last stored scan's `T_odom_sensor` (4, 4).
    """

    session: SessionKey
    session_number: int
    committed_seq: int
    resume_token: str
    marks: ScanMarks
    travelled_m: float
    T_odom_sensor: Matrix4 | None


@dataclass(frozen=True)
class _Packed:
    """A scan that passed validation, and its cloud to store."""

    scan: Scan
    cloud: bytes
    sha256: str


class Scans:
    """Open a session's stream and append scans to it."""

    def __init__(self, context: CallContext, decoder: CloudDecoder, in_flight: InFlight) -> None:
        """`in_flight` counts clouds that arrive, and open streams."""
        self._context = context
        self._decoder = decoder
        self._in_flight = in_flight
        self._deletions = SharedPoll(context.storage, _still_there)
        self._appending = Appending(context.storage, context.jobs, context.policy, context.clock)
        self._kept: Remembered[tuple[TenantId, str], tuple[int, RetentionPolicy]] = Remembered()

    async def open(self, tenant: TenantId, session: SessionKey, resume: ResumePoint = ResumePoint()) -> OpenedStream:
        """Where the session stands.

        Raises NotFound, also where the token is another session's; SequenceGap where fewer scans are stored than were
        acknowledged (an older backup was restored); SessionFinished, Draining.
        """
        self._context.admission.require_running()
        record, last, marks = await self._context.storage.read(
            partial(_standing_at, tenant=tenant, key=session, policy=self._context.policy)
        )
        token = f"{record.number:x}-{record.created_at_ns:x}"
        if resume.token not in ("", token):
            raise NotFound("the resume token is of another session")
        if resume.acknowledged_seq > record.committed_seq:
            raise SequenceGap(record.committed_seq + 1, resume.acknowledged_seq + 1)
        require_active(record)
        T_odom_sensor = None if last is None else pose_matrix(last.T_odom_sensor)
        of = (session, record.number, record.committed_seq, token)
        return OpenedStream(*of, marks, record.travelled_m, T_odom_sensor)

    async def deleted(self, tenant: TenantId, session_number: int) -> None:
        """Returns once the session is deleted, by whichever gateway, or with its map."""
        while not await self._deletions.has_come(tenant, session_number, ENDS_WITHIN_S):
            pass

    def reserve_stream(self, tenant: TenantId, *, replaces: bool) -> AbstractContextManager[None]:
        """The slot of one more stream (see `InFlight.reserve_stream`). Raises RateLimited."""
        return self._in_flight.reserve_stream(tenant, replaces=replaces)

    async def append(self, tenant: TenantId, command: AppendScan, *, patient: bool = False) -> ScanAck:
        """Store one scan durably; returns after the commit. A `patient` one waits for a slot.

        Raises the errors of decoding and validation, NotFound, SessionFinished, SequenceGap(expected), AlreadyExists
        for other content under the number of a stored scan, WorkersBusy, RateLimited, QuotaReached, Draining,
        StorageFull, StorageUncertain; StreamFenced where a newer stream of the session took over.
        """
        self._context.admission.require_storage()
        session = await self._standing(tenant, command)
        replay = is_replay(session, command.seq)
        if not replay:
            await self._context.admission.require_room(tenant)
        price = reading_points(command.cloud)
        async with self._context.admission.cloud(
            tenant, refused_points=price, patient=patient, queued=False
        ) as decoded:
            packed = await self._decoder.run(tenant, _packed, command)
            decoded(len(packed.scan.points))
            of = (tenant, command.session, session.number, command.stream, command.seq)
            accepted = AcceptedScan(*of, packed.scan, packed.sha256, command.travelled_m)
            if replay:
                return await self._replayed(session, accepted, packed.cloud)
            return await self._store(accepted, packed.cloud)

    async def _standing(self, tenant: TenantId, command: AppendScan) -> SessionRecord:
        """The session, as far as it is known; by its row unless this is the next scan of a stream that holds it."""
        known = self._appending.known(command.stream)
        if known is not None and command.seq == known.committed_seq + 1:
            return known
        return await self._context.storage.read(partial(require_session, tenant=tenant, key=command.session))

    async def _keeps_described_alone(self, accepted: AcceptedScan) -> bool:
        """Whether the map keeps no scan for a while that no description is made of."""
        now_ms, of_map = self._context.clock.monotonic_ms(), (accepted.tenant, accepted.session.map_id)
        read_ms, policy = self._kept.get(of_map, (now_ms - POLICY_HOLDS_MS, KEEPS_ALL))
        if now_ms - read_ms >= POLICY_HOLDS_MS:
            record = await self._context.storage.read(partial(require_map, tenant=of_map[0], map_id=of_map[1]))
            policy = self._context.policy.kept_of(record)
            self._kept[of_map] = (now_ms, policy)
        return policy.keep_scans is not KeptScans.ALL and policy.scans_after_hours == 0.0

    async def _replayed(self, session: SessionRecord, accepted: AcceptedScan, cloud: bytes) -> ScanAck:
        """The answer to a scan with a number that is taken. Raises AlreadyExists unless it is the stored one again."""
        stored = await self._context.storage.read(partial(stored_scan, session=session, seq=accepted.seq))
        if stored is not None and not await self._is_stored(stored, accepted, cloud):
            raise taken(session, accepted.seq)
        return ScanAck(session.committed_seq, replay=True, report=None, submap=None)

    async def _is_stored(self, stored: ScanRecord, accepted: AcceptedScan, cloud: bytes) -> bool:
        """Whether this is the stored scan. Another compressor may have packed the stored cloud: then points decide."""
        if not same_place(stored, accepted):
            return False
        if stored.cloud_sha256 in (accepted.sha256, ""):  # "": retention has removed it
            return True
        packed = await asyncio.to_thread(
            self._context.storage.blobs.get, stored.tenant, CLOUD_BLOB, stored.cloud_sha256
        )
        return await self._decoder.run(stored.tenant, _same_points, packed, cloud)

    async def _store(self, accepted: AcceptedScan, cloud: bytes) -> ScanAck:
        put = partial(self._context.storage.blobs.put, accepted.tenant, CLOUD_BLOB, cloud)
        if self._appending.leaves_out(accepted) and await self._keeps_described_alone(accepted):
            accepted = replace(accepted, left_out=True)
        else:
            await asyncio.to_thread(put)
        failpoint("ingest.after_blob")
        ack = await self._appending.append(accepted, put)
        self._context.admission.note_stored(accepted.tenant, 0 if ack.left_out else len(accepted.scan.points))
        failpoint("ingest.after_commit")
        if ack.submap is None:
            return ack
        return replace(ack, submap=await with_seq(self._context.storage, accepted.tenant, ack.submap))


def _standing_at(
    uow: UnitOfWork, tenant: TenantId, key: SessionKey, policy: Policy
) -> tuple[SessionRecord, ScanRecord | None, ScanMarks]:
    """A session, its last scan, and the marks of its map. Raises NotFound."""
    session = require_session(uow, tenant, key)
    config = policy.for_map(require_map(uow, tenant, key.map_id)).submap
    return session, stored_scan(uow, session, session.committed_seq), ScanMarks.of(config)


def _packed(command: AppendScan) -> _Packed:
    if command.travelled_m is not None:
        limits.TRAVELLED_M.validated(command.travelled_m, "travelled_m")
    cloud, report = accept_cloud(command.cloud, limits.SCAN_POINTS)
    scan = Scan.posed(cloud.points, report, command.T_odom_sensor, command.stamp_ns)
    packed = pack_cloud(cloud)
    return _Packed(scan, packed, hashlib.sha256(packed).hexdigest())


def _still_there(uow: UnitOfWork, tenant: TenantId, session_numbers: frozenset[int]) -> Collection[int]:
    """Those sessions that are not deleted."""
    return uow.sessions.numbered(tenant, sorted(session_numbers))


def _same_points(one: bytes, other: bytes) -> bool:
    first, second = unpack_cloud(one), unpack_cloud(other)
    return same(first.columns, second.columns) and np.array_equal(first.points, second.points)
