"""Windows of a session's scans: where the current one stands, and the submap of a complete one.

A window is the state of `core.submap.SubmapBuilder` as a value that a row can hold. The builder keeps scans in memory;
here they are rows, and a window is the range of their sequence numbers, so that an unfinished window survives a
restart. A test holds the two against each other on random drives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from revisit.core.config import SubmapConfig
from revisit.core.geometry.se3 import pose_matrix, position_row
from revisit.core.submap import next_window_start
from revisit.service.application.capacity.backlog import JobPosting
from revisit.service.application.contract.identity import RESERVED_SUBMAP_PREFIX, content_hash
from revisit.service.application.contract.records import ScanRecord, SessionRecord, SubmapRecord
from revisit.service.application.contract.states import SubmapState
from revisit.service.application.contract.transactions import UnitOfWork
from revisit.service.application.ingest.submap_posting import PostedSubmap, add_submap, posted_submap
from revisit.service.application.ingest.submap_source import chosen_seqs


@dataclass(frozen=True)
class Window:
    """The window since scan `first_seq`; distances in metres travelled since the session began."""

    first_seq: int
    start_m: float
    travelled_m: float
    emitted_to_m: float | None


@dataclass(frozen=True)
class ScanRange:
    """The scans first..last of a finished submap."""

    first: int
    last: int


def window_of(session: SessionRecord) -> Window:
    """The window that a session's row holds."""
    return Window(session.window_first_seq, session.window_start_m, session.travelled_m, session.emitted_to_m)


FirstSeqFrom = Callable[[float], int | None]
"""The first stored scan taken at or beyond a travelled distance in metres."""


def advance(
    window: Window, seq: int, step_m: float, config: SubmapConfig, first_seq_from: FirstSeqFrom
) -> tuple[Window, ScanRange | None]:
    """The window after scan `seq`, taken `step_m` metres beyond the last one, and the submap that it completes."""
    travelled = window.travelled_m + step_m
    if travelled - window.start_m < config.tau:
        return Window(window.first_seq, window.start_m, travelled, window.emitted_to_m), None
    start = next_window_start(window.start_m, travelled, config)
    # The newest scan always stays: the next step is measured from it.
    first_kept = first_seq_from(start)
    first = seq if first_kept is None else max(window.first_seq, first_kept)
    return Window(first, start, travelled, travelled), ScanRange(window.first_seq, seq)


def remainder(window: Window, committed_seq: int) -> ScanRange | None:
    """The scans of a last, shorter submap at the end of a session, or None where nothing new was seen."""
    if committed_seq == 0 or window.travelled_m == window.emitted_to_m:
        return None
    return ScanRange(window.first_seq, committed_seq)


def add_window_submap(
    uow: UnitOfWork, jobs: JobPosting, session: SessionRecord, scans: ScanRange, now_ns: int
) -> tuple[PostedSubmap, SessionRecord]:
    """Add the submap of the stored `scans` and its job, in the caller's transaction. Raises WorkersBusy."""
    seqs = chosen_seqs(scans.first, scans.last)
    stored = uow.scans.with_seqs(session.tenant, session.map_id, session.session_id, seqs)
    row = _row(session, stored, scans, now_ns)
    added, counted = add_submap(uow, jobs, session, row)
    return posted_submap(uow, added, replay=False, report=None), counted


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
