"""The submap of a range of a session's scans: of a complete window, or of the remainder when the session ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from revisit.core.geometry.se3 import pose_matrix, position_row
from revisit.service.capacity.backlog import JobPosting
from revisit.service.domain.identity import RESERVED_SUBMAP_PREFIX, content_hash
from revisit.service.domain.records import ScanRecord, SessionRecord, SubmapRecord
from revisit.service.domain.states import SubmapState
from revisit.service.features.ingest.posting import PostedSubmap, add_submap, posted_submap
from revisit.service.features.ingest.rows import chosen_scans, spread_rows
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class ScanRange:
    """The scans first..last of a finished submap."""

    first: int
    last: int


def remainder(uow: UnitOfWork, session: SessionRecord) -> ScanRange | None:
    """The scans of a last, shorter submap at the end of a session, or None where nothing new was seen."""
    rest = ScanRange(session.window_first_seq, session.committed_seq)
    scans = _scans_of(uow, session, rest) if session.committed_seq else []
    return rest if scans and scans[-1].travelled_m != session.emitted_to_m else None


def add_window_submap(
    uow: UnitOfWork, jobs: JobPosting, session: SessionRecord, scans: ScanRange, now_ns: int
) -> tuple[PostedSubmap, SessionRecord]:
    """Add the submap of the stored `scans` and its job, in the caller's transaction. Raises WorkersBusy."""
    row = _row(session, _scans_of(uow, session, scans), scans, now_ns)
    added, counted = add_submap(uow, jobs, session, row)
    return posted_submap(uow, added, replay=False, report=None), counted


def _scans_of(uow: UnitOfWork, session: SessionRecord, scans: ScanRange) -> list[ScanRecord]:
    """The chosen scans of a window; all of one that was stored before scans were chosen as they came."""
    chosen = chosen_scans(uow, session.tenant, session.key, scans.first, scans.last)
    if chosen:
        return chosen
    seqs = spread_rows(scans.first, scans.last)
    return uow.scans.with_seqs(session.tenant, session.map_id, session.session_id, seqs)


def _row(session: SessionRecord, stored: list[ScanRecord], scans: ScanRange, now_ns: int) -> SubmapRecord:
    """As `core.submap.Submap.from_scans`: the frame of the middle scan, the mean of the positions."""
    middle = stored[len(stored) // 2]
    positions = np.array([pose_matrix(scan.T_odom_sensor)[:3, 3] for scan in stored])
    return SubmapRecord(
        tenant=session.tenant,
        map_id=session.map_id,
        session_id=session.session_id,
        submap_id=f"{RESERVED_SUBMAP_PREFIX}{scans.first}-{scans.last}",
        content_hash=content_hash([scans.first, scans.last]),
        state=SubmapState.QUEUED.value,
        ordinal=0,
        session_number=0,
        T_odom_submap=middle.T_odom_sensor,
        position_m=position_row(positions.mean(axis=0)),
        stamp_ns=middle.stamp_ns,
        cloud_sha256=None,
        first_seq=scans.first,
        last_seq=scans.last,
        scan_count=len(stored),
        point_count=sum(scan.point_count for scan in stored),
        operation_id="",
        flags=(),
        created_at_ns=now_ns,
    )
