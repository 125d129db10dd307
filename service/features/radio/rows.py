"""The fingerprint of a submap: the readings of its session while it was driven."""

from __future__ import annotations

from revisit.core.radio import RadioFingerprint
from revisit.service.domain.records import RadioReadingRecord, SubmapRecord
from revisit.service.ports.transactions import UnitOfWork

SLICE_NS = 10 * 10**9
"""Readings are found by the slice of time that they are in."""

MOST_SLICES, MOST_OF_SLICE = 30, 50
"""Of a submap that a robot stands in for long, so many slices, evenly spread; of each, the first so many readings."""

BESIDE_NS = 5 * 10**9
"""A reading so long before or behind a submap is of it, too: receivers look every few seconds."""


def slice_of(stamp_ns: int) -> int:
    """The slice of a time."""
    return stamp_ns // SLICE_NS


def fingerprint_of(uow: UnitOfWork, submap: SubmapRecord) -> bytes | None:
    """The stored fingerprint of a submap; None where nobody told any."""
    if not uow.radio_readings.find(submap.tenant, limit=1, map_id=submap.map_id, session_id=submap.session_id):
        return None
    first_ns, last_ns = _driven(uow, submap)
    first_ns, last_ns = first_ns - BESIDE_NS, last_ns + BESIDE_NS
    first, last = slice_of(first_ns), slice_of(last_ns)
    count = min(last - first + 1, MOST_SLICES)
    slices = sorted({first + round(step * (last - first) / max(count - 1, 1)) for step in range(count)})
    readings = [
        RadioFingerprint.of_bytes(one.heard).heard
        for its in slices
        for one in _in_slice(uow, submap, its)
        if first_ns <= one.stamp_ns <= last_ns
    ]
    return RadioFingerprint.of(readings).to_bytes() if readings else None


def _in_slice(uow: UnitOfWork, submap: SubmapRecord, its: int) -> list[RadioReadingRecord]:
    """Readings of the session of a submap."""
    return uow.radio_readings.find(
        submap.tenant, limit=MOST_OF_SLICE, map_id=submap.map_id, session_id=submap.session_id, time_slice=its
    )


def _driven(uow: UnitOfWork, submap: SubmapRecord) -> tuple[int, int]:
    """When a submap was begun and ended, nanoseconds; of a posted cloud its one time."""
    if submap.first_seq is None or submap.last_seq is None:
        return submap.stamp_ns, submap.stamp_ns
    ends = sorted({submap.first_seq, submap.last_seq})
    scans = uow.scans.with_seqs(submap.tenant, submap.map_id, submap.session_id, ends)
    stamps = [scan.stamp_ns for scan in scans] or [submap.stamp_ns]
    return min(stamps), max(stamps)
