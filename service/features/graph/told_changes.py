"""The changes that a drive found, told once: by the first version that has it after it has ended, where a webhook asks
for them (docs/decisions/0352).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace

from revisit.core.merge.evidence import ChangeKind
from revisit.service.capacity.backlog import queued_job
from revisit.service.domain.events import EventRecord
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import MapRecord, SessionRecord
from revisit.service.domain.states import (
    EventKind,
    OperationKind,
    OperationState,
    SessionState,
    SubmapState,
    WebhookState,
)
from revisit.service.features.graph.map_jobs import LAST
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

    One such job of a map at a time, after all other work of the tenant: versions come while it runs.
    """
    record = uow.maps.get(tenant, map_id)
    if record is None or not untold_drives(uow, record) or _is_comparing(uow, tenant, map_id):
        return
    payload = {"map_id": map_id, "version": record.map_version}
    subject = f"maps/{map_id}/versions/{record.map_version}"
    uow.queue.enqueue(queued_job(tenant, OperationKind.FIND_CHANGES, subject, payload, policy, now_ns, LAST))


def _is_comparing(uow: UnitOfWork, tenant: TenantId, map_id: str) -> bool:
    kind, states = OperationKind.FIND_CHANGES.value, (OperationState.QUEUED, OperationState.RUNNING)
    jobs = (job for state in states for job in uow.jobs.find(tenant, kind=kind, state=state.value))
    return any(job.payload["map_id"] == map_id for job in jobs)


def untold_drives(uow: UnitOfWork, record: MapRecord, version: int | None = None) -> list[SessionRecord]:
    """The drives of whose changes a webhook wants to be told, and was not: ended since it is there, described, and in
    one frame with others in a version, None: that in force.
    """
    since_ns = _asked_since_ns(uow, record.tenant, record.map_id)
    if since_ns is None:
        return []
    asked = record.map_version if version is None else version
    return [one for one in _ended(uow, record, since_ns) if _is_compared(uow, one, asked)]


def _ended(uow: UnitOfWork, record: MapRecord, since_ns: int) -> list[SessionRecord]:
    """The drives that have ended since then and of which nothing was told; earlier ones are noted as told."""
    state = SessionState.FINISHED.value
    untold = uow.sessions.find(record.tenant, map_id=record.map_id, state=state, changes_told=None)
    before = [one for one in untold if (one.finished_at_ns or 0) < since_ns]
    uow.sessions.revise(before, changes_told=DriveChanges(0).stored)
    return [one for one in untold if (one.finished_at_ns or 0) >= since_ns]


def _asked_since_ns(uow: UnitOfWork, tenant: TenantId, map_id: str) -> int | None:
    """Since when a webhook asks for changes of a map; None where none does."""
    asking = (
        one.created_at_ns
        for one in uow.webhooks.find(tenant, state=WebhookState.ENABLED.value)
        if EventKind.MAP_CHANGED in one.kinds and one.map_id in (None, map_id)
    )
    return min(asking, default=None)


def _is_compared(uow: UnitOfWork, session: SessionRecord, version: int) -> bool:
    own: dict[str, str | int] = {"map_id": session.map_id, "session_id": session.session_id}
    frames = uow.session_poses.distinct(session.tenant, "frame", version=version, **own)
    in_frame: dict[str, str | int] = {"map_id": session.map_id, "version": version}
    shared = any(uow.session_poses.count(session.tenant, frame=frame, **in_frame) > 1 for frame in frames)
    return shared and not uow.submaps.count(session.tenant, state=SubmapState.QUEUED.value, **own)


def tell_changes(uow: UnitOfWork, drives: Sequence[SessionRecord], found: Mapping[int, DriveChanges]) -> None:
    """Note, and record as an event where there are any, what drives found changed, by number of session."""
    for session in drives:
        told = found[session.number]
        uow.sessions.replace(replace(session, changes_told=told.stored))
        if told.found_any:
            event = EventRecord(session.tenant, session.map_id, EventKind.MAP_CHANGED.value, str(session.number))
            uow.events.record(event)
