"""Scans: a stream of posed sweeps that the service cuts into submaps.

A session's row holds the window of scans that the next submap is made of: the state of `core.submap.SubmapBuilder`. The
builder keeps scans in memory; here they are rows, and a window is the range of their sequence numbers, so that an
unfinished one survives a restart. A test holds the two against each other on random drives.
"""

from __future__ import annotations

import asyncio
import hashlib
import secrets
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from revisit.core.config import SubmapConfig
from revisit.core.errors import BadField
from revisit.core.geometry.se3 import Matrix4, pose_matrix, pose_row
from revisit.core.scan import CloudReport, Scan
from revisit.core.submap import next_window_start
from revisit.service.capacity.in_flight import InFlight
from revisit.service.domain import limits
from revisit.service.domain.errors import AlreadyExists, NotFound, SequenceGap, StreamFenced
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.records import ScanRecord, SessionRecord
from revisit.service.failpoints import failpoint
from revisit.service.features.ingest.clouds import (
    CloudDecoder,
    CloudInput,
    accept_cloud,
    pack_cloud,
    reading_points,
    unpack_cloud,
)
from revisit.service.features.ingest.posting import PostedSubmap, with_seq
from revisit.service.features.ingest.window_submaps import ScanRange, add_window_submap
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.waiting.shared_poll import SharedPoll
from revisit.service.ports.blobs import CLOUD_BLOB
from revisit.service.ports.storage import require_active, require_map, require_session
from revisit.service.ports.transactions import UnitOfWork

SAME_POSE = 1e-9
"""Numbers of a pose that differ by less, metres or none, are the same number rounded twice."""

ENDS_WITHIN_S = 1.0
"""An idle stream ends so soon after its session was deleted: one question a tenant for all streams of a gateway."""

SESSIONS_REMEMBERED = 4096
"""Sessions with their window rules in memory, about 1 kB each."""


FirstSeqFrom = Callable[[float], int | None]
"""The first stored scan taken at or beyond a travelled distance in metres."""


@dataclass(frozen=True)
class ScanStream:
    """A stream of a session's scans. The newest one stores them, whichever gateway each stream leads to.

    A stream takes over with the first scan that it stores; from then on it may store none after a newer one has.
    """

    token: str
    session_number: int
    took_over: bool = False

    @classmethod
    def of(cls, session_number: int) -> ScanStream:
        """A stream that has stored nothing yet."""
        return cls(secrets.token_hex(16), session_number)

    def begun(self) -> ScanStream:
        """The stream once it has stored a scan."""
        return replace(self, took_over=True)

    def entered(self, session: SessionRecord) -> SessionRecord:
        """The session as this stream stores a scan in it.

        Raises StreamFenced where a newer one took over; NotFound where its session was deleted, and this is another.
        """
        if session.number != self.session_number:
            raise NotFound(f"session {session.session_id!r} was deleted"[:300])
        if self.took_over and session.stream != self.token:
            raise StreamFenced
        return replace(session, stream=self.token)


@dataclass(frozen=True)
class AppendScan:
    """The scan with client sequence number `seq` (1, 2, 3, ...), taken from `T_odom_sensor` (4, 4), of `stream`."""

    session: SessionKey
    seq: int
    stamp_ns: int
    T_odom_sensor: Matrix4
    cloud: CloudInput
    stream: ScanStream | None = None


@dataclass(frozen=True)
class ScanAck:
    """The scan is durable. `committed_seq` is the last durable one; `submap` is the one that this scan completed.

    A scan that is stored already is acknowledged and ignored (`replay`).
    """

    committed_seq: int
    replay: bool
    report: CloudReport | None
    submap: PostedSubmap | None


@dataclass(frozen=True)
class ResumePoint:
    """A client's memory of a session: the token of an earlier stream, if any, and the last acknowledged scan."""

    token: str = ""
    acknowledged_seq: int = 0


@dataclass(frozen=True)
class OpenedStream:
    """Where a client resumes: the next scan to send is `committed_seq + 1`.

    `resume_token` and `session_number` name this session and no other that may get its name later.
    """

    session: SessionKey
    session_number: int
    committed_seq: int
    resume_token: str


@dataclass(frozen=True)
class _Accepted:
    """A scan that passed validation, and its cloud to store."""

    seq: int
    scan: Scan
    packed: bytes
    sha256: str


class Scans:
    """Open a session's stream and append scans to it."""

    def __init__(self, context: CallContext, decoder: CloudDecoder, in_flight: InFlight) -> None:
        """`in_flight` counts clouds that arrive, and open streams."""
        self._context = context
        self._decoder = decoder
        self._in_flight = in_flight
        self._deletions = SharedPoll(context.storage, _still_there)
        self._window_configs: dict[int, SubmapConfig] = {}

    async def open(self, tenant: TenantId, session: SessionKey, resume: ResumePoint = ResumePoint()) -> OpenedStream:
        """Where the session stands.

        Raises NotFound, also where the token is another session's; SequenceGap where fewer scans are stored than were
        acknowledged (an older backup was restored); SessionFinished, Draining.
        """
        self._context.admission.require_running()
        record = await self._context.storage.read(partial(require_session, tenant=tenant, key=session))
        token = f"{record.number:x}-{record.created_at_ns:x}"
        if resume.token not in ("", token):
            raise NotFound("the resume token is of another session")
        if resume.acknowledged_seq > record.committed_seq:
            raise SequenceGap(record.committed_seq + 1, resume.acknowledged_seq + 1)
        require_active(record)
        return OpenedStream(session, record.number, record.committed_seq, token)

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
        session = await self._context.storage.read(partial(require_session, tenant=tenant, key=command.session))
        replay = _is_replay(session, command.seq)
        if not replay:
            await self._context.admission.require_room(tenant)
        price = reading_points(command.cloud)
        async with self._context.admission.cloud(
            tenant, refused_points=price, patient=patient, queued=False
        ) as decoded:
            accepted = await self._decoder.run(tenant, _accept, command)
            decoded(len(accepted.scan.points))
            if replay:
                return await self._replayed(session, accepted)
            return await self._store(tenant, command, accepted)

    async def _replayed(self, session: SessionRecord, accepted: _Accepted) -> ScanAck:
        """The answer to a scan with a number that is taken. Raises AlreadyExists unless it is the stored one again."""
        stored = await self._context.storage.read(partial(_stored_scan, session=session, seq=accepted.seq))
        if stored is not None and not await self._is_stored(stored, accepted):
            raise _taken(session, accepted.seq)
        return ScanAck(session.committed_seq, replay=True, report=None, submap=None)

    async def _is_stored(self, stored: ScanRecord, accepted: _Accepted) -> bool:
        """Whether this is the stored scan. Another compressor may have packed the stored cloud: then points decide."""
        if not _same_place(stored, accepted):
            return False
        if stored.cloud_sha256 in (accepted.sha256, ""):  # "": retention has removed it
            return True
        packed = await asyncio.to_thread(
            self._context.storage.blobs.get, stored.tenant, CLOUD_BLOB, stored.cloud_sha256
        )
        return await self._decoder.run(stored.tenant, _same_points, packed, accepted.packed)

    async def _store(self, tenant: TenantId, command: AppendScan, accepted: _Accepted) -> ScanAck:
        put = partial(self._context.storage.blobs.put, tenant, CLOUD_BLOB, accepted.packed)
        await asyncio.to_thread(put)
        failpoint("ingest.after_blob")
        insert = partial(self._insert, tenant=tenant, command=command, accepted=accepted)
        ack = await self._context.storage.write_naming(insert, put)
        self._context.admission.note_stored(tenant, len(accepted.scan.points))
        failpoint("ingest.after_commit")
        if ack.submap is None:
            return ack
        return replace(ack, submap=await with_seq(self._context.storage, tenant, ack.submap))

    def _insert(self, uow: UnitOfWork, tenant: TenantId, command: AppendScan, accepted: _Accepted) -> ScanAck:
        session = require_session(uow, tenant, command.session, hold=True)
        if _is_replay(session, accepted.seq):
            stored = _stored_scan(uow, session, accepted.seq)
            # It came a moment ago, by the same compressor.
            if stored is not None and not (_same_place(stored, accepted) and stored.cloud_sha256 == accepted.sha256):
                raise _taken(session, accepted.seq)
            return ScanAck(session.committed_seq, replay=True, report=None, submap=None)
        session = session if command.stream is None else command.stream.entered(session)
        last = uow.scans.get(session.tenant, session.map_id, session.session_id, session.committed_seq)
        step_m = _step_m(last, accepted.scan)
        uow.blobs.refer(tenant, [(CLOUD_BLOB, accepted.sha256)])
        uow.scans.add(_row(session, accepted, session.travelled_m + step_m))
        submap = self._advance(uow, session, accepted.seq, step_m)
        return ScanAck(accepted.seq, replay=False, report=accepted.scan.report, submap=submap)

    def _advance(self, uow: UnitOfWork, session: SessionRecord, seq: int, step_m: float) -> PostedSubmap | None:
        """Move the session's window on; the submap that is complete now, if one is."""
        config = self._window_config(uow, session)
        first_seq_from = partial(uow.scans.first_seq_from, session.tenant, session.map_id, session.session_id)
        moved, finished = advance(session, seq, step_m, config, first_seq_from)
        if finished is None:
            uow.sessions.replace(moved)
            return None
        return add_window_submap(uow, self._context.jobs, moved, finished, self._context.clock.wall_ns())[0]

    def _window_config(self, uow: UnitOfWork, session: SessionRecord) -> SubmapConfig:
        """How the session's scans are cut into submaps: rules of its map, which never change, so they are read once."""
        if session.number not in self._window_configs:
            if len(self._window_configs) == SESSIONS_REMEMBERED:
                self._window_configs.clear()
            config = self._context.policy.for_map(require_map(uow, session.tenant, session.map_id)).submap
            self._window_configs[session.number] = config
        return self._window_configs[session.number]


def advance(
    session: SessionRecord, seq: int, step_m: float, config: SubmapConfig, first_seq_from: FirstSeqFrom
) -> tuple[SessionRecord, ScanRange | None]:
    """The session after scan `seq`, taken `step_m` metres beyond the last one, and the window that it completes."""
    travelled = session.travelled_m + step_m
    if travelled - session.window_start_m < config.tau:
        return replace(session, committed_seq=seq, travelled_m=travelled), None
    start = next_window_start(session.window_start_m, travelled, config)
    # The newest scan always stays: the next step is measured from it.
    first_kept = first_seq_from(start)
    first = seq if first_kept is None else max(session.window_first_seq, first_kept)
    moved = replace(
        session,
        committed_seq=seq,
        travelled_m=travelled,
        window_first_seq=first,
        window_start_m=start,
        emitted_to_m=travelled,
    )
    return moved, ScanRange(session.window_first_seq, seq)


def _accept(command: AppendScan) -> _Accepted:
    cloud, report = accept_cloud(command.cloud, limits.SCAN_POINTS)
    scan = Scan.posed(cloud.points, report, command.T_odom_sensor, command.stamp_ns)
    packed = pack_cloud(cloud)
    return _Accepted(command.seq, scan, packed, hashlib.sha256(packed).hexdigest())


def _still_there(uow: UnitOfWork, tenant: TenantId, session_numbers: frozenset[int]) -> Collection[int]:
    """Those sessions that are not deleted."""
    return uow.sessions.numbered(tenant, sorted(session_numbers))


def _is_replay(session: SessionRecord, seq: int) -> bool:
    """Whether the scan is durable already. Raises BadField; SessionFinished; SequenceGap beyond the next one."""
    following = session.committed_seq + 1
    if seq == following:
        require_active(session)
        return False
    limits.SCAN_SEQ.validated(seq, "seq")
    if seq < following:
        return True
    require_active(session)
    raise SequenceGap(following, seq)


def _stored_scan(uow: UnitOfWork, session: SessionRecord, seq: int) -> ScanRecord | None:
    return uow.scans.get(session.tenant, session.map_id, session.session_id, seq)


def _same_place(stored: ScanRecord, accepted: _Accepted) -> bool:
    """Whether time and pose are those of the stored scan, but for rounding."""
    difference = pose_matrix(stored.T_odom_sensor) - accepted.scan.T_odom_sensor
    return stored.stamp_ns == accepted.scan.stamp_ns and bool(np.abs(difference).max() < SAME_POSE)


def _same_points(one: bytes, other: bytes) -> bool:
    first, second = unpack_cloud(one), unpack_cloud(other)
    if first.intensity is None or second.intensity is None:
        return first.intensity is second.intensity and np.array_equal(first.points, second.points)
    same_intensity = np.array_equal(first.intensity, second.intensity, equal_nan=True)
    return same_intensity and np.array_equal(first.points, second.points)


def _taken(session: SessionRecord, seq: int) -> AlreadyExists:
    return AlreadyExists(
        f"scan {seq} of session {session.session_id} is stored with other content. Where odometry began again (the "
        f"robot restarted, another recording), create a new session; else go on with scan {session.committed_seq + 1}"
    )


def _step_m(last: ScanRecord | None, scan: Scan) -> float:
    """How far the sensor moved since the last stored scan, metres. Raises BadField where time went backwards."""
    if last is None:
        return 0.0
    if scan.stamp_ns < last.stamp_ns:
        raise BadField(f"stamp_ns lies before that of the last stored scan, {last.stamp_ns}", field="stamp_ns")
    return float(np.linalg.norm(scan.T_odom_sensor[:3, 3] - pose_matrix(last.T_odom_sensor)[:3, 3]))


def _row(session: SessionRecord, accepted: _Accepted, travelled_m: float) -> ScanRecord:
    return ScanRecord(
        tenant=session.tenant,
        map_id=session.map_id,
        session_id=session.session_id,
        seq=accepted.seq,
        stamp_ns=accepted.scan.stamp_ns,
        T_odom_sensor=pose_row(accepted.scan.T_odom_sensor),
        travelled_m=travelled_m,
        point_count=len(accepted.scan.points),
        cloud_sha256=accepted.sha256,
    )
