"""Sessions: one drive of one robot, in one odometry frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from revisit.core.pose_graph.graph import OdometryModel
from revisit.core.sanity.finding import LEAST_SHARES, LIKELY_CAUSES
from revisit.service.domain.identity import (
    SessionKey,
    TenantId,
    content_hash,
    validated_detail,
    validated_id,
)
from revisit.service.domain.records import SessionDetails, SessionRecord
from revisit.service.domain.states import SessionState
from revisit.service.failpoints import failpoint
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.features.catalogue.no_loops import NoLoops, why_no_loops
from revisit.service.features.catalogue.odometry_findings import SessionFinding, odometry_findings
from revisit.service.features.deletion.erasure import Erasure
from revisit.service.features.deletion.rows import mark_session
from revisit.service.features.graph.posting import optimise_soon
from revisit.service.features.graph.told_changes import find_changes_soon
from revisit.service.features.ingest.window_submaps import add_window_submap, remainder
from revisit.service.features.loops.waiting import accept_decided
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, rows_of_map
from revisit.service.ports.storage import (
    require_deleted,
    require_map,
    require_robot,
    require_same_content,
    require_session,
)
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class CreateSession(SessionDetails):
    """A new session in a map; `robot_id` is None or an existing robot."""

    map_id: str
    session_id: str
    robot_id: str | None = None

    def content(self) -> list[str | None]:
        """What makes another session of it: robot and details, the storey without its name."""
        details = {name: value for name, value in self.validated().items() if value is not None}
        # Sessions of before there were storeys have the hash of their robot alone.
        storey = [details.pop("storey")] if "storey" in details else []
        return [self.robot_id, *storey, *(f"{name}={value}" for name, value in details.items())]

    def validated(self) -> dict[str, Any]:
        """The details by name. Raises BadField."""
        OdometryModel.stated(self.drift)
        return {name: validated_detail(value, name) for name, value in SessionDetails.of(self).items()}


@dataclass(frozen=True, kw_only=True)
class SessionView(SessionRecord):
    """A session; `committed_stamp_ns` is when the scan `committed_seq` was taken.

    `findings` are those of its submaps so far, the most frequent first, then those that the version of the map in force
    has of its odometry. `no_loops` says why a finished session has no loop. Neither is in lists of sessions.
    """

    submap_count: int
    committed_stamp_ns: int | None
    findings: tuple[SessionFinding, ...] = ()
    no_loops: NoLoops | None = None


@dataclass(frozen=True)
class CreatedSession:
    """The session, and whether an earlier identical request had created it."""

    session: SessionView
    replay: bool


class Sessions:
    """Create, get, list, finish and delete sessions."""

    def __init__(self, context: CallContext, erasure: Erasure) -> None:
        """A deleted session goes through `erasure`, and its `streams` end."""
        self._context = context
        self._erasure = erasure

    async def create(self, tenant: TenantId, command: CreateSession) -> CreatedSession:
        """Create a session.

        Raises BadField; NotFound for map or robot; AlreadyExists for other content; StillDeleting where a session of
        this id was deleted and is not gone yet; Draining, RateLimited.
        """
        self._context.admission.charge_creation(tenant)
        record = self._record(tenant, command)
        return await self._context.storage.write(partial(_add, record=record))

    async def get(self, tenant: TenantId, key: SessionKey) -> SessionView:
        """Raises NotFound."""
        return await self._context.storage.read(lambda uow: self._whole(uow, require_session(uow, tenant, key)))

    async def list(self, tenant: TenantId, map_id: str, page: PageRequest) -> Page[SessionView]:
        """The sessions of a map, oldest first. Raises NotFound for the map."""
        find = rows_of_map(lambda uow: uow.sessions, tenant, map_id)
        return await self._context.lists.page(tenant, page, find, _view)

    async def finish(self, tenant: TenantId, key: SessionKey) -> SessionView:
        """Close the session; the scans of its last, shorter window become a submap. Again: no effect.

        Raises NotFound, WorkersBusy, Draining.
        """
        self._context.admission.require_running()
        closed = await self._context.storage.write(partial(self._finish, tenant=tenant, key=key))
        failpoint("session.after_finish")
        return closed

    def _finish(self, uow: UnitOfWork, tenant: TenantId, key: SessionKey) -> SessionView:
        require_map(uow, tenant, key.map_id, hold=True)  # as all that accept loops do, and first
        session, now_ns = require_session(uow, tenant, key, hold=True), self._context.clock.wall_ns()
        if session.state == SessionState.FINISHED:
            return self._whole(uow, session)
        rest = remainder(uow, session)
        if rest is not None:
            _, session = add_window_submap(uow, self._context.jobs, session, rest, now_ns)
        finished = replace(session, state=SessionState.FINISHED.value, finished_at_ns=now_ns)
        uow.sessions.replace(finished)
        if accept_decided(uow, tenant, key, now_ns):
            optimise_soon(uow, tenant, key.map_id, self._context.policy, now_ns)
        if uow.anchors.find(tenant, limit=1, map_id=key.map_id, session_id=key.session_id):
            optimise_soon(uow, tenant, key.map_id, self._context.policy, now_ns, decided=True)
        find_changes_soon(uow, tenant, key.map_id, self._context.policy, now_ns)
        return self._whole(uow, finished)

    async def delete(self, tenant: TenantId, key: SessionKey) -> None:
        """Delete a session with its scans, its submaps and their loop closures; its streams end, its jobs are dropped.

        Nobody sees anything of it from the commit on. Its id is free again once its rows are gone, which a large
        session takes longer for than this call (`erasure.AWAITED_S`). Raises NotFound, Draining.
        """
        self._context.admission.require_running()
        entry = audit.noted(tenant, "session_deleted", key.name)
        delete = partial(_delete, key=key, entry=entry, at_ns=self._context.clock.wall_ns())
        await self._context.storage.write(delete)
        failpoint("delete.after_mark")
        await self._erasure.soon(tenant, key.map_id, key.session_id)

    def _whole(self, uow: UnitOfWork, record: SessionRecord) -> SessionView:
        """The view with its findings, for which all submaps of the session are looked at, and why it has no loop."""
        counts = uow.submaps.flag_counts(record.tenant, record.map_id, record.session_id)
        known = ((code.lower(), count) for code, count in counts.items() if code.lower() in LIKELY_CAUSES)
        told = ((code, count) for code, count in known if count >= LEAST_SHARES.get(code, 0.0) * record.next_ordinal)
        ordered = sorted(told, key=lambda found: (-found[1], found[0]))
        of_submaps = (SessionFinding(code, count, *LIKELY_CAUSES[code]) for code, count in ordered)
        config = self._context.policy.for_map(require_map(uow, record.tenant, record.map_id))
        why = why_no_loops(uow, record, config.loop)
        return replace(_view(uow, record), findings=(*of_submaps, *odometry_findings(uow, record)), no_loops=why)

    def _record(self, tenant: TenantId, command: CreateSession) -> SessionRecord:
        return SessionRecord(
            tenant=tenant,
            map_id=command.map_id,
            session_id=validated_id(command.session_id, "session_id"),
            content_hash=content_hash(command.content()),
            robot_id=command.robot_id,
            state=SessionState.ACTIVE.value,
            committed_seq=0,
            next_ordinal=0,
            travelled_m=0.0,
            window_start_m=0.0,
            window_first_seq=1,
            emitted_to_m=None,
            created_at_ns=self._context.clock.wall_ns(),
            finished_at_ns=None,
            **command.validated(),
        )


def _add(uow: UnitOfWork, record: SessionRecord) -> CreatedSession:
    require_map(uow, record.tenant, record.map_id)
    known = uow.sessions.get(record.tenant, record.map_id, record.session_id)
    if known is None:
        require_deleted(uow, record.tenant, record.map_id, record.session_id)
        if record.robot_id is not None:
            require_robot(uow, record.tenant, record.robot_id)
        return CreatedSession(_view(uow, uow.sessions.add(record)), replay=False)
    require_same_content(known.content_hash, record.content_hash, f"session {record.session_id}")
    return CreatedSession(_view(uow, known), replay=True)


def _delete(uow: UnitOfWork, key: SessionKey, entry: AuditEntry, at_ns: int) -> None:
    tenant = TenantId(entry.tenant)
    of_map = require_map(uow, tenant, key.map_id, hold=True)
    session = require_session(uow, tenant, key, hold=True)
    audit.append(uow, at_ns, entry)
    mark_session(uow, of_map, session, at_ns)


def _view(uow: UnitOfWork, record: SessionRecord) -> SessionView:
    last = uow.scans.get(record.tenant, record.map_id, record.session_id, record.committed_seq)
    return SessionView(
        **vars(record),
        submap_count=uow.submaps.count(record.tenant, map_id=record.map_id, session_id=record.session_id),
        committed_stamp_ns=None if last is None else last.stamp_ns,
    )
