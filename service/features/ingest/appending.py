"""Scans become rows: each in its turn, or those that wait together, in a few statements for all of them."""

from __future__ import annotations

import asyncio
import secrets
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from revisit.core.config import SubmapConfig
from revisit.core.errors import BadField, RevisitError
from revisit.core.geometry.se3 import pose_matrix, pose_row
from revisit.core.scan import CloudReport, Scan
from revisit.core.scan_marks import ROUNDED_M, ChosenScan, ScanMarks, Way
from revisit.core.submap import next_window_start
from revisit.service.capacity.backlog import JobPosting
from revisit.service.capacity.budget import Remembered
from revisit.service.domain import limits
from revisit.service.domain.errors import AlreadyExists, BlobCollected, NotFound, SequenceGap, StreamFenced
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import ScanRecord, SessionRecord
from revisit.service.features.ingest.posting import PostedSubmap
from revisit.service.features.ingest.window_submaps import ScanRange, add_window_submap
from revisit.service.ports.blobs import CLOUD_BLOB, Blob
from revisit.service.ports.clock import Clock
from revisit.service.ports.storage import Storage, require_active, require_map, require_session
from revisit.service.ports.transactions import UnitOfWork

SAME_POSE = 1e-9
"""Numbers of a pose that differ by less, metres or none, are the same number rounded twice."""

SESSIONS_REMEMBERED = 4096
"""Sessions with their window rules and last scan in memory, about 2 kB each."""

MOST_TOGETHER = 64
"""Scans of one batch: each is a few rows of its statements."""

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
class ScanAck:
    """The scan is durable. `committed_seq` is the last durable one; `submap` is the one that this scan completed.

    A scan that is stored already is acknowledged and ignored (`replay`). Of one that is `left_out` the cloud is not
    kept: no description would be made of it, and the map keeps scans of descriptions alone.
    """

    committed_seq: int
    replay: bool
    report: CloudReport | None
    submap: PostedSubmap | None
    left_out: bool = False


@dataclass(frozen=True)
class AcceptedScan:
    """A scan of `session` that passed validation, and its stored cloud; `session_number` as it was when it came.

    `travelled_m`: how far the session had travelled, as its robot counts. `left_out`: the cloud is not stored.
    """

    tenant: TenantId
    session: SessionKey
    session_number: int
    stream: ScanStream | None
    seq: int
    scan: Scan
    sha256: str
    travelled_m: float | None = None
    left_out: bool = False


class CloudWanted(Exception):
    """A description is made of a scan whose cloud was to be left out: another stream has changed the session."""


@dataclass(frozen=True)
class _Standing:
    """Where a session stands: its row, its way, its last scan, and the last one that was chosen, if it has one.

    The way that its robot counts was shorter than the straight one by `short_m` metres together.
    """

    session: SessionRecord
    way: Way | None
    last: ScanRecord | None
    chosen: ChosenScan | None
    short_m: float = 0.0

    def followed(self, accepted: AcceptedScan, config: SubmapConfig) -> tuple[_Standing, ScanRecord]:
        """The session with one scan more, and the row of that. Raises BadField, StreamFenced, NotFound."""
        session = self.session if accepted.stream is None else accepted.stream.entered(self.session)
        marks = ScanMarks.of(config)
        way, short_m = _way(self, accepted, marks)
        pose, returns = accepted.scan.T_odom_sensor, len(accepted.scan.points)
        chosen = marks.choose(self.chosen, way.travelled_m, pose, returns)
        row = _row(session, accepted, way.travelled_m, chosen=chosen is not None)
        moved = replace(session, committed_seq=accepted.seq, travelled_m=way.travelled_m)
        return _Standing(moved, way, row, chosen or self.chosen, short_m), row


@dataclass(frozen=True)
class _Appended:
    """An acknowledgement, and where the session stands with it; None where nothing was added."""

    ack: ScanAck
    standing: _Standing | None


class Appending:
    """Appends accepted scans to their sessions. It remembers where each stands; the rows decide."""

    def __init__(self, storage: Storage, jobs: JobPosting, policy: Policy, clock: Clock) -> None:
        """`jobs` describe the submaps that are complete; `policy` says when they are, and `clock` labels them."""
        self._storage = storage
        self._jobs = jobs
        self._policy = policy
        self._clock = clock
        self._window_configs: Remembered[int, SubmapConfig] = Remembered(SESSIONS_REMEMBERED)
        self._standings: Remembered[int, _Standing] = Remembered(SESSIONS_REMEMBERED)
        self._batch = _Batch(self)

    def known(self, stream: ScanStream | None) -> SessionRecord | None:
        """The session of a stream as this gateway left it; None where the row has to tell.

        While a stream holds its session, nobody else appends to it.
        """
        if stream is None or not stream.took_over:
            return None
        standing = self._standings.get(stream.session_number)
        return standing.session if standing is not None and standing.session.stream == stream.token else None

    async def append(self, accepted: AcceptedScan, put: Callable[[], object]) -> ScanAck:
        """Store the row of a scan durably, with others that wait; `put` stores its cloud again.

        Raises as `insert`, and StorageFull, StorageUncertain.
        """
        appended = None if self._completes(accepted) else await self._together(accepted)
        if appended is None:
            try:
                appended = await self._storage.write_naming(partial(self.insert, accepted=accepted), put)
            except CloudWanted:
                await asyncio.to_thread(put)
                stored = replace(accepted, left_out=False)
                appended = await self._storage.write_naming(partial(self.insert, accepted=stored), put)
        if appended.standing is not None:
            self._standings[accepted.session_number] = appended.standing
        return appended.ack

    def leaves_out(self, accepted: AcceptedScan) -> bool:
        """Whether no description will be made of a scan, as far as this gateway knows."""
        expected = self._expected(accepted)
        return expected is not None and not expected[1].chosen

    def _completes(self, accepted: AcceptedScan) -> bool:
        """Whether a scan completes a submap, as far as this gateway knows."""
        expected = self._expected(accepted)
        return expected is not None and completes(*expected)

    def _expected(self, accepted: AcceptedScan) -> tuple[SessionRecord, ScanRecord, SubmapConfig] | None:
        """The session before a scan, the row of that, and the rules of its map; None where this gateway does not know
        the session, or refuses the scan.
        """
        standing, config = (of.get(accepted.session_number) for of in (self._standings, self._window_configs))
        if not isinstance(standing, _Standing) or not isinstance(config, SubmapConfig):
            return None
        with suppress(RevisitError):
            if not is_replay(standing.session, accepted.seq):
                return standing.session, standing.followed(accepted, config)[1], config
        return None

    async def _together(self, accepted: AcceptedScan) -> _Appended | None:
        """As `append`, with others; None where the scan is to be stored by itself: it completes a submap, or fails."""
        if not self._batch.add(accepted):
            self._batch = _Batch(self)
            self._batch.add(accepted)
        batch = self._batch
        if batch.written is None:
            batch.written = asyncio.ensure_future(self._storage.write(batch))
        try:
            return (await asyncio.shield(batch.written)).get(id(accepted))
        except (AlreadyExists, NotFound, BlobCollected):  # of any of them: each is stored by itself
            return None

    def insert(self, uow: UnitOfWork, accepted: AcceptedScan) -> _Appended:
        """Add the row of one scan, and the submap that it completes.

        Raises NotFound, SessionFinished, SequenceGap, AlreadyExists, StreamFenced, WorkersBusy; BadField where time
        went backwards.
        """
        session = require_session(uow, accepted.tenant, accepted.session, hold=True)
        if is_replay(session, accepted.seq):
            stored = stored_scan(uow, session, accepted.seq)
            # It came a moment ago, by the same compressor.
            if stored is not None and not (
                same_place(stored, accepted) and stored.cloud_sha256 in (accepted.sha256, "")
            ):
                raise taken(session, accepted.seq)
            return _Appended(ScanAck(session.committed_seq, replay=True, report=None, submap=None), None)
        config = self._window_config(uow, session)
        after, row = self._standing(uow, session).followed(accepted, config)
        if row.chosen and accepted.left_out:
            raise CloudWanted
        uow.blobs.refer(accepted.tenant, _named(accepted))
        scan = uow.scans.add(row)
        moved, submap = self._advance(uow, after.session, scan, config)
        ack = _acknowledged(accepted, submap)
        return _Appended(ack, replace(after, session=moved, last=scan))

    def insert_all(self, uow: UnitOfWork, scans: Sequence[AcceptedScan]) -> dict[int, _Appended]:
        """As `insert`, scans of any sessions in a few statements; what was added, by the `id` of its scan.

        Left out are those that are to be stored by themselves. Raises AlreadyExists, NotFound, BlobCollected where the
        rows of all are refused for one of them.
        """
        appended, rows = dict[int, _Appended](), list[ScanRecord]()
        standings = {session.number: self._standing(uow, session) for session in _held(uow, scans)}
        for scan in scans:
            before = standings.get(scan.session_number)
            after = None if before is None else self._next(before, scan)
            if after is not None and after.last is not None:
                standings[scan.session_number] = after
                rows.append(after.last)
                appended[id(scan)] = _Appended(_acknowledged(scan, None), after)
        added = [scan for scan in scans if id(scan) in appended]
        for tenant in sorted({scan.tenant for scan in added}):
            uow.blobs.refer(tenant, [blob for scan in added if scan.tenant == tenant for blob in _named(scan)])
        uow.scans.add_all(rows)
        moved = {scan.session_number for scan in added}
        uow.sessions.replace_all([standings[number].session for number in sorted(moved)])
        return appended

    def _next(self, before: _Standing, accepted: AcceptedScan) -> _Standing | None:
        """Where a session stands with one scan more; None where the scan is to be stored by itself."""
        config = self._window_configs.get(before.session.number)
        try:
            if config is None or is_replay(before.session, accepted.seq):
                return None
            after, row = before.followed(accepted, config)
        except RevisitError:
            return None
        alone = completes(before.session, row, config) or (row.chosen and accepted.left_out)
        return None if alone else after

    def _standing(self, uow: UnitOfWork, session: SessionRecord) -> _Standing:
        """Where a session stands by its row: of its scans, which never change, those that matter are remembered."""
        known = self._standings.get(session.number)
        if known is not None and known.last is not None and known.last.seq == session.committed_seq:
            return replace(known, session=session)
        of, last = (session.tenant, session.map_id, session.session_id), session.committed_seq
        chosen = uow.scans.chosen_between(*of, 1, last, newest=1)
        counted = uow.scans.first_seq_from(*of, session.travelled_m)
        at = None if counted is None else stored_scan(uow, session, counted)
        way = None if at is None else Way(session.travelled_m, pose_matrix(at.T_odom_sensor))
        return _Standing(session, way, stored_scan(uow, session, last), _chosen_of(chosen))

    def _advance(
        self, uow: UnitOfWork, moved: SessionRecord, scan: ScanRecord, config: SubmapConfig
    ) -> tuple[SessionRecord, PostedSubmap | None]:
        """Move the session's window on; the session then, and the submap that is complete now, if one is."""
        first_seq_from = partial(uow.scans.first_seq_from, moved.tenant, moved.map_id, moved.session_id)
        moved, finished = advance(moved, scan, config, first_seq_from)
        if finished is None:
            uow.sessions.replace(moved)
            return moved, None
        submap, counted = add_window_submap(uow, self._jobs, moved, finished, self._clock.wall_ns())
        return counted, submap

    def _window_config(self, uow: UnitOfWork, session: SessionRecord) -> SubmapConfig:
        """How the session's scans are cut into submaps: rules of its map, which never change, so they are read once."""
        config = self._window_configs.get(session.number)
        if config is None:
            config = self._policy.for_map(require_map(uow, session.tenant, session.map_id)).submap
            self._window_configs[session.number] = config
        return config


class _Batch:
    """Scans that wait for the same transaction. Those that come before it begins join it."""

    def __init__(self, appending: Appending) -> None:
        self.written: asyncio.Future[dict[int, _Appended]] | None = None
        self._appending = appending
        self._scans: list[AcceptedScan] = []
        self._begun = False
        self._changing = threading.Lock()

    def add(self, scan: AcceptedScan) -> bool:
        """Let one more wait; whether there was room."""
        with self._changing:
            if self._begun or len(self._scans) >= MOST_TOGETHER:
                return False
            self._scans.append(scan)
            return True

    def __call__(self, uow: UnitOfWork) -> dict[int, _Appended]:
        """Store them, in the writer's thread."""
        with self._changing:
            self._begun = True
        return self._appending.insert_all(uow, self._scans)


def _held(uow: UnitOfWork, scans: Sequence[AcceptedScan]) -> Iterator[SessionRecord]:
    """The sessions of scans, held in the order of their numbers."""
    for tenant in sorted({scan.tenant for scan in scans}):
        numbers = sorted({scan.session_number for scan in scans if scan.tenant == tenant})
        yield from uow.sessions.numbered(tenant, numbers, hold=True).values()


def completes(session: SessionRecord, scan: ScanRecord, config: SubmapConfig) -> bool:
    """Whether the next scan of a session completes its window: windows end with a chosen one."""
    return scan.chosen and scan.travelled_m - session.window_start_m >= config.tau


def advance(
    session: SessionRecord, scan: ScanRecord, config: SubmapConfig, first_seq_from: FirstSeqFrom
) -> tuple[SessionRecord, ScanRange | None]:
    """The session after its newest scan, whose distance it has travelled, and the window that this completes."""
    if not completes(session, scan, config):
        return session, None
    start = next_window_start(session.window_start_m, scan.travelled_m, config)
    # The newest scan always stays: the next step is measured from it.
    first_kept = first_seq_from(start)
    first = scan.seq if first_kept is None else max(session.window_first_seq, first_kept)
    finished = replace(session, window_first_seq=first, window_start_m=start, emitted_to_m=scan.travelled_m)
    return finished, ScanRange(session.window_first_seq, scan.seq)


def is_replay(session: SessionRecord, seq: int) -> bool:
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


def stored_scan(uow: UnitOfWork, session: SessionRecord, seq: int) -> ScanRecord | None:
    """The scan of this number."""
    return uow.scans.get(session.tenant, session.map_id, session.session_id, seq)


def same_place(stored: ScanRecord, accepted: AcceptedScan) -> bool:
    """Whether time and pose are those of the stored scan, but for rounding."""
    difference = pose_matrix(stored.T_odom_sensor) - accepted.scan.T_odom_sensor
    return stored.stamp_ns == accepted.scan.stamp_ns and bool(np.abs(difference).max() < SAME_POSE)


def taken(session: SessionRecord, seq: int) -> AlreadyExists:
    """The error of a scan with the number of another one."""
    return AlreadyExists(
        f"scan {seq} of session {session.session_id} is stored with other content. Where odometry began again (the "
        f"robot restarted, another recording), create a new session; else go on with scan {session.committed_seq + 1}"
    )


def _way(standing: _Standing, accepted: AcceptedScan, marks: ScanMarks) -> tuple[Way, float]:
    """The way of a session with its next scan, and its `short_m` then. Raises BadField where time went backwards.

    The robot's count is taken where it is possible; else, as where it began to count anew, the straight way. Both may
    wait with a step of their own: by so much the count may be shorter, over all scans together.
    """
    last, scan = standing.last, accepted.scan
    if last is not None and scan.stamp_ns < last.stamp_ns:
        raise BadField(f"stamp_ns lies before that of the last stored scan, {last.stamp_ns}", field="stamp_ns")
    counted, told_m = marks.way_to(scan.T_odom_sensor, standing.way), accepted.travelled_m
    if told_m is None:
        return counted, standing.short_m
    lacking_m, most_m = counted.travelled_m - told_m, 2.0 * marks.least_step_m + ROUNDED_M
    if standing.way is not None and lacking_m <= most_m and told_m <= standing.way.travelled_m:
        return standing.way, standing.short_m
    short_m = standing.short_m + lacking_m
    if short_m > most_m:
        return counted, standing.short_m
    return Way(told_m, scan.T_odom_sensor), max(0.0, short_m)


def _chosen_of(newest: Sequence[ScanRecord]) -> ChosenScan | None:
    """The state of the choice after its newest scan, if there is one; of those before at its mark nothing is known."""
    orientations = tuple(pose_matrix(row.T_odom_sensor)[:3, :3] for row in newest)
    return ChosenScan(newest[-1].travelled_m, orientations) if newest else None


def _named(accepted: AcceptedScan) -> list[Blob]:
    return [] if accepted.left_out else [(CLOUD_BLOB, accepted.sha256)]


def _acknowledged(accepted: AcceptedScan, submap: PostedSubmap | None) -> ScanAck:
    report = accepted.scan.report
    return ScanAck(accepted.seq, replay=False, report=report, submap=submap, left_out=accepted.left_out)


def _row(session: SessionRecord, accepted: AcceptedScan, travelled_m: float, *, chosen: bool) -> ScanRecord:
    return ScanRecord(
        tenant=session.tenant,
        map_id=session.map_id,
        session_id=session.session_id,
        seq=accepted.seq,
        stamp_ns=accepted.scan.stamp_ns,
        T_odom_sensor=pose_row(accepted.scan.T_odom_sensor),
        travelled_m=travelled_m,
        point_count=0 if accepted.left_out else len(accepted.scan.points),
        cloud_sha256="" if accepted.left_out else accepted.sha256,
        chosen=chosen,
    )
