"""Removing what a map does not keep, one short transaction after another.

First the rows say that scans or a submap are gone, then rows go, and with them their names of blobs: those that no row
has named for an hour are collected. A kill in between leaves rows that nobody asks for: the next process removes them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TypeVar

from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import LoopRecord, MapRecord, ScanRecord, SessionRecord, SubmapRecord
from revisit.service.domain.retention import KeptScans
from revisit.service.domain.states import LoopState, SubmapState
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.features.deletion.blob_references import blobs_of_scans
from revisit.service.features.deletion.rows import mark_session
from revisit.service.features.ingest.rows import described_scans
from revisit.service.features.loops.rows import decided_by_person
from revisit.service.features.retention.due import AWAITING, ENDS, map_rests_on
from revisit.service.features.retention.rules import LESS, HeldScans
from revisit.service.ports.blobs import CLOUD_BLOB, NEURAL_MAP_BLOB, PLACE_BLOB, Blob
from revisit.service.ports.transactions import UnitOfWork

ACTOR = "retention"
"""The actor of removals in the audit log."""

SCANS = 80
SUBMAPS = 30
WINDOWS = 5
"""Submaps of which one transaction marks the scans that stay: each has hundreds."""
LOOPS = 80
"""Of one transaction: none holds the lock of the writers for a tenth of a second."""


T = TypeVar("T")


@dataclass(frozen=True)
class Removed:
    """What a transaction has removed: rows, and the blobs that these named and others may name still."""

    rows: int = 0
    blobs: frozenset[Blob] = frozenset()


def portions(items: Iterable[T], size: int) -> Iterator[tuple[T, ...]]:
    """The items in their order, at most `size` at a time."""
    rest = iter(items)
    while some := tuple(islice(rest, size)):
        yield some


def delete_session(uow: UnitOfWork, session: SessionRecord, at_ns: int) -> Removed:
    """Delete a session that a map does not rest on, as `DeleteSession` does; nothing where that has changed."""
    current = uow.sessions.get(session.tenant, session.map_id, session.session_id)
    record = uow.maps.get(session.tenant, session.map_id)
    if record is None or current is None or current.number != session.number or map_rests_on(uow, current):
        return Removed()
    name = SessionKey(session.map_id, session.session_id).name
    audit.append(uow, at_ns, AuditEntry(session.tenant, ACTOR, "session_deleted", audit.printable(name), {}))
    mark_session(uow, record, current, at_ns)
    return Removed(1)


def retire(uow: UnitOfWork, record: MapRecord, numbers: Sequence[int]) -> Removed:
    """Take submaps out of the index; their place, descriptor and posted cloud go.

    Their poses, loops and neural maps stay, of which the versions of the map are made.
    """
    found = uow.submaps.numbered(record.tenant, numbers).values()
    waiting = _newly_awaiting(uow, record)
    gone = [one for one in found if one.state == SubmapState.DESCRIBED and one.searched and one.number not in waiting]
    doomed = set[Blob]()
    for one in gone:
        named = ((PLACE_BLOB, one.place_sha256), (CLOUD_BLOB, one.cloud_sha256))
        doomed |= {(kind, sha256) for kind, sha256 in named if sha256 is not None}
        uow.submaps.replace(_without_place(one))
    uow.changes.record_removed(record, [one.number for one in gone])
    return _released(uow, record.tenant, len(gone), doomed)


def _without_place(submap: SubmapRecord) -> SubmapRecord:
    return replace(
        submap,
        state=SubmapState.RETIRED.value,
        descriptor=None,
        place_sha256=None,
        cloud_sha256=None,
        kept_scans=KeptScans.NONE.value,
    )


def release_maps(uow: UnitOfWork, record: MapRecord, numbers: Sequence[int], filed: Collection[str]) -> Removed:
    """Retired submaps lose their neural maps, but for those that are `filed`, by hash."""
    waiting = _newly_awaiting(uow, record)
    due = [
        one
        for one in uow.submaps.numbered(record.tenant, numbers).values()
        if one.state == SubmapState.RETIRED
        and one.neural_map_sha256 is not None
        and one.neural_map_sha256 not in filed
        and one.number not in waiting
    ]
    uow.submaps.revise(due, neural_map_sha256=None, neural_map_bytes=None)
    doomed = {(NEURAL_MAP_BLOB, str(one.neural_map_sha256)) for one in due}
    return _released(uow, record.tenant, len(due), doomed)


def release(uow: UnitOfWork, record: MapRecord, numbers: Sequence[int], kept: KeptScans, rules: Policy) -> Removed:
    """Say of submaps that of their scans only those of the description are kept, or none; posted clouds go."""
    waiting = _newly_awaiting(uow, record)
    found = uow.submaps.numbered(record.tenant, numbers).values()
    due = [one for one in found if one.kept_scans in LESS[kept] and one.number not in waiting]
    if kept is KeptScans.DESCRIBED:
        config = rules.for_map(record).submap
        chosen = {scan.number: scan for one in due for scan in described_scans(uow, one, config)}
        uow.scans.revise(list(chosen.values()), chosen=True)
    posted = [one for one in due if one.cloud_sha256 is not None]
    doomed = {(CLOUD_BLOB, str(one.cloud_sha256)) for one in posted}
    for one in posted:
        uow.submaps.replace(replace(one, cloud_sha256=None, kept_scans=kept.value))
    uow.submaps.revise([one for one in due if one.cloud_sha256 is None], kept_scans=kept.value)
    return _released(uow, record.tenant, len(due), doomed)


def _released(uow: UnitOfWork, tenant: TenantId, rows: int, blobs: set[Blob]) -> Removed:
    """Rows that named these blobs are gone."""
    uow.blobs.release(tenant, blobs)
    return Removed(rows, frozenset(blobs))


def _newly_awaiting(uow: UnitOfWork, record: MapRecord) -> set[int]:
    """Ends of proposals: they may have been made since the removal was planned."""
    of_map = {"map_id": record.map_id, **AWAITING[0]}
    return {number for end in ENDS for number in uow.loops.distinct(record.tenant, end, **of_map)}


def drop_scans(uow: UnitOfWork, scans: Sequence[ScanRecord]) -> Removed:
    """Delete scans that nothing holds."""
    numbers = [scan.number for scan in scans]
    uow.scans.delete_some(scans[0].tenant, len(numbers), "number", numbers)
    return _released(uow, scans[0].tenant, len(numbers), blobs_of_scans(scans))


def drop_last_cloud(uow: UnitOfWork, session: SessionRecord, held: HeldScans) -> Removed:
    """The row of a finished session's newest scan stays, without its cloud, once nothing holds that."""
    newest = uow.scans.get(session.tenant, session.map_id, session.session_id, session.committed_seq)
    if newest is None or not held.frees_cloud(newest):
        return Removed()
    uow.scans.replace(replace(newest, cloud_sha256="", point_count=0))
    return _released(uow, session.tenant, 1, blobs_of_scans([newest]))


def drop_loops(uow: UnitOfWork, loops: Sequence[LoopRecord]) -> Removed:
    """Delete rejected pairs with their history; not those that a person has decided on, or that changed meanwhile."""
    numbers = uow.loops.numbered(loops[0].tenant, [loop.number for loop in loops])
    due = [
        loop
        for loop in loops
        if loop.number in numbers
        and (numbers[loop.number].state, numbers[loop.number].reason) == (LoopState.REJECTED, loop.reason)
        and not decided_by_person(uow, loop)
    ]
    for loop in due:
        uow.loop_events.delete(loop.tenant, map_id=loop.map_id, loop_id=loop.loop_id)
    uow.loops.delete_some(loops[0].tenant, len(loops), "number", [loop.number for loop in due])
    return Removed(len(due))
