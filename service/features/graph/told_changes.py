"""The changes that a drive found, told once: by the first version that has it after it has ended, where a webhook asks
for them (docs/decisions/0352).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace

from revisit.core.merge.evidence import ChangeKind
from revisit.service.capacity.backlog import LAST, queued_job, unended_jobs
from revisit.service.domain.events import EventRecord
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import MapRecord, SessionRecord
from revisit.service.domain.states import (
    EventKind,
    OperationKind,
    SessionState,
    SubmapState,
    WebhookState,
)
from revisit.service.features.graph.posting import optimise_soon
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.ports.transactions import UnitOfWork

COUNTED = (ChangeKind.APPEARED, ChangeKind.VANISHED, ChangeKind.MOVED, ChangeKind.BACK)


@dataclass(frozen=True)
class DriveChanges:
    """How many things a drive found changed, by the version of the map in which it was compared with earlier ones."""

    version: int
    appeared: int = 0
    vanished: int = 0
    moved: int = 0
    back: int = 0

    @classmethod
    def of_kinds(cls, version: int, kinds: Sequence[str]) -> DriveChanges:
        """Of the kinds of all changes that the drive found."""
        return cls(version, *(kinds.count(kind.value) for kind in COUNTED))

    @classmethod
    def of(cls, stored: str) -> DriveChanges:
        """As a session keeps it."""
        return cls(*map(int, stored.split(":")))

    @property
    def stored(self) -> str:
        """The inverse of `of`."""
        return ":".join(map(str, astuple(self)))

    @property
    def found_any(self) -> bool:
        """Whether anything has changed."""
        return any(astuple(self)[1:])


def find_changes_soon(uow: UnitOfWork, tenant: TenantId, map_id: str, policy: Policy, now_ns: int) -> None:
    """Let the drives of a map be compared where one has ended of whose changes a webhook wants to be told.

    One such job of a map at a time, after all other work of the tenant: versions come while it runs. Where the version
    in force lacks the end of such a drive, the map is optimised with it.
    """
    record = uow.maps.get(tenant, map_id)
    joined = [] if record is None else _joined(uow, record, record.map_version)
    if not all(drive.is_whole for drive in joined):
        optimise_soon(uow, tenant, map_id, policy, now_ns, decided=True)
    if record is None or not any(drive.is_described for drive in joined) or _is_comparing(uow, tenant, map_id):
        return
    payload = {"map_id": map_id, "version": record.map_version}
    subject = f"maps/{map_id}/versions/{record.map_version}"
    uow.queue.enqueue(queued_job(tenant, OperationKind.FIND_CHANGES, subject, payload, policy, now_ns, LAST))


def _is_comparing(uow: UnitOfWork, tenant: TenantId, map_id: str) -> bool:
    comparing = unended_jobs(uow, tenant, OperationKind.FIND_CHANGES)
    return any(job.payload["map_id"] == map_id for job in comparing)


def untold_drives(uow: UnitOfWork, record: MapRecord, version: int) -> list[SessionRecord]:
    """The drives of whose changes a webhook wants to be told, and was not: ended since it is there, and with all their
    submaps, described, in one frame with others in a version.
    """
    return [drive.session for drive in _joined(uow, record, version) if drive.is_described]


@dataclass(frozen=True)
class _Joined:
    """A drive in one frame with others in a version: whether that has all of its submaps, and these are described."""

    session: SessionRecord
    is_whole: bool
    is_described: bool


def _joined(uow: UnitOfWork, record: MapRecord, version: int) -> list[_Joined]:
    """The drives that a version joins with others and of whose changes a webhook wants to be told, and was not."""
    since_ns = _asked_since_ns(uow, record.tenant, record.map_id)
    ended = [] if since_ns is None else _ended(uow, record, since_ns)
    found = (_joined_drive(uow, one, version) for one in ended)
    return [drive for drive in found if drive is not None]


def _joined_drive(uow: UnitOfWork, session: SessionRecord, version: int) -> _Joined | None:
    """A drive where the version joins it with others."""
    tenant, map_id, session_id = session.tenant, session.map_id, session.session_id
    rows = uow.session_poses.find(tenant, map_id=map_id, version=version, session_id=session_id)
    count = uow.session_poses.count
    if not any(count(tenant, map_id=map_id, version=version, frame=row.frame) > 1 for row in rows):
        return None
    known = {int(number) for row in rows for number in PackedSubmaps.of(row.submaps).numbers}
    is_whole = uow.submaps.distinct(tenant, "number", map_id=map_id, session_id=session_id) <= known
    waiting = uow.submaps.count(tenant, map_id=map_id, session_id=session_id, state=SubmapState.QUEUED.value)
    return _Joined(session, is_whole, is_whole and not waiting)


def _ended(uow: UnitOfWork, record: MapRecord, since_ns: int) -> list[SessionRecord]:
    """The drives that have ended since then and of which nothing was told; those are noted as told that ended before
    any webhook asked: one that is suspended is told of the others once it is resumed.
    """
    state = SessionState.FINISHED.value
    untold = uow.sessions.find(record.tenant, map_id=record.map_id, state=state, changes_told=None)
    ever_ns = _asked_since_ns(uow, record.tenant, record.map_id, suspended=True) or since_ns
    before = [one for one in untold if (one.finished_at_ns or 0) < ever_ns]
    uow.sessions.revise(before, changes_told=DriveChanges(0).stored)
    return [one for one in untold if (one.finished_at_ns or 0) >= since_ns]


def _asked_since_ns(uow: UnitOfWork, tenant: TenantId, map_id: str, *, suspended: bool = False) -> int | None:
    """Since when a webhook asks for changes of a map, of those that are `suspended` too; None where none does."""
    asking = (
        one.created_at_ns
        for one in uow.webhooks.find(tenant)
        if EventKind.MAP_CHANGED in one.kinds
        and one.map_id in (None, map_id)
        and (suspended or one.state == WebhookState.ENABLED)
    )
    return min(asking, default=None)


def tell_changes(uow: UnitOfWork, drives: Sequence[SessionRecord], found: Mapping[int, DriveChanges]) -> None:
    """Note, and record as an event where there are any, what drives found changed, by number of session."""
    for session in drives:
        told = found[session.number]
        uow.sessions.replace(replace(session, changes_told=told.stored))
        if told.found_any:
            event = EventRecord(session.tenant, session.map_id, EventKind.MAP_CHANGED.value, str(session.number))
            uow.events.record(event)
