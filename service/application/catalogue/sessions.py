"""Sessions: one drive of one robot, in one odometry frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

from revisit.service.application.access import audit
from revisit.service.application.catalogue.deletion import delete_session
from revisit.service.application.catalogue.maps import require_map
from revisit.service.application.catalogue.paging import Page, PageRequest, page_of
from revisit.service.application.catalogue.robots import require_robot
from revisit.service.application.catalogue.session_lookup import SessionState, require_session
from revisit.service.application.contract.context import Context
from revisit.service.application.contract.errors import AlreadyExists
from revisit.service.application.contract.identity import SessionKey, TenantId, content_hash, validated_id
from revisit.service.application.contract.ports import UnitOfWork
from revisit.service.application.contract.records import SessionRecord
from revisit.service.application.housekeeping.blob_references import Blob, collect_blobs_in_turns
from revisit.service.application.ingest.scan_windows import remainder
from revisit.service.application.ingest.window_submaps import add_window_submap, window_of
from revisit.service.failpoints import failpoint


@dataclass(frozen=True)
class CreateSession:
    """A new session in a map; `robot_id` is None or an existing robot."""

    map_id: str
    session_id: str
    robot_id: str | None = None


@dataclass(frozen=True)
class SessionView:
    """A session as clients see it.

    `committed_seq` is the last scan stored durably, 0 for none; `committed_stamp_ns` is when that one was taken.
    """

    key: SessionKey
    robot_id: str | None
    state: SessionState
    committed_seq: int
    travelled_m: float
    submap_count: int
    created_at_ns: int
    finished_at_ns: int | None
    committed_stamp_ns: int | None


@dataclass(frozen=True)
class CreatedSession:
    """The session, and whether an earlier identical request had created it."""

    session: SessionView
    replay: bool


class Sessions:
    """Create, get, list, finish and delete sessions."""

    def __init__(self, context: Context) -> None:
        """All calls use `context`."""
        self._context = context

    async def create(self, tenant: TenantId, command: CreateSession) -> CreatedSession:
        """Create a session. Raises BadField; NotFound for map or robot; AlreadyExists for other content; Draining."""
        self._context.admit()
        record = self._record(tenant, command)

        def add(uow: UnitOfWork) -> CreatedSession:
            require_map(uow, tenant, command.map_id)
            known = uow.sessions.get(tenant, command.map_id, command.session_id)
            if known is None:
                if command.robot_id is not None:
                    require_robot(uow, tenant, command.robot_id)
                return CreatedSession(_view(uow, uow.sessions.add(record)), replay=False)
            if known.content_hash != record.content_hash:
                raise AlreadyExists(f"session {command.session_id} exists with other content")
            return CreatedSession(_view(uow, known), replay=True)

        return await self._context.write(add)

    async def get(self, tenant: TenantId, key: SessionKey) -> SessionView:
        """Raises NotFound."""
        return await self._context.read(lambda uow: _view(uow, require_session(uow, tenant, key)))

    async def list(self, tenant: TenantId, map_id: str, page: PageRequest) -> Page[SessionView]:
        """The sessions of a map, oldest first. Raises NotFound for the map."""

        def load(uow: UnitOfWork) -> Page[SessionView]:
            require_map(uow, tenant, map_id)
            records = uow.sessions.find(tenant, after=page.after, limit=page.size + 1, map_id=map_id)
            return page_of(records, page, lambda record: _view(uow, record))

        return await self._context.read(load)

    async def finish(self, tenant: TenantId, key: SessionKey) -> SessionView:
        """Close the session; the scans of its last, shorter window become a submap. Again: no effect.

        Raises NotFound, WorkersBusy, Draining.
        """
        self._context.admit()

        def close(uow: UnitOfWork) -> SessionView:
            session = require_session(uow, tenant, key)
            if session.state == SessionState.FINISHED:
                return _view(uow, session)
            rest = remainder(window_of(session), session.committed_seq)
            if rest is not None:
                _, session = add_window_submap(uow, self._context, session, rest)
            finished_at_ns = self._context.clock.wall_ns()
            finished = replace(session, state=SessionState.FINISHED.value, finished_at_ns=finished_at_ns)
            uow.sessions.replace(finished)
            return _view(uow, finished)

        closed = await self._context.write(close)
        failpoint("session.after_finish")
        return closed

    async def delete(self, tenant: TenantId, key: SessionKey) -> None:
        """Delete a session with its scans, its submaps and their loop closures; its streams end, its jobs are dropped.

        Its id is free again. Raises NotFound, Draining.
        """
        self._context.admit()
        entry, at_ns = audit.noted(tenant, "session_deleted", key.name), self._context.clock.wall_ns()

        def remove(uow: UnitOfWork) -> set[Blob]:
            session = require_session(uow, tenant, key)
            audit.append(uow, at_ns, entry)
            return delete_session(uow, require_map(uow, tenant, key.map_id), session, at_ns)

        doomed = await self._context.write(remove)
        failpoint("delete.after_rows")
        self._context.stream_endings.end(tenant, key.map_id, key.session_id)
        await collect_blobs_in_turns(self._context, tenant, doomed)

    def _record(self, tenant: TenantId, command: CreateSession) -> SessionRecord:
        return SessionRecord(
            tenant=tenant,
            map_id=command.map_id,
            session_id=validated_id(command.session_id, "session_id"),
            content_hash=content_hash([command.robot_id]),
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
        )


def _view(uow: UnitOfWork, record: SessionRecord) -> SessionView:
    last = uow.scans.get(record.tenant, record.map_id, record.session_id, record.committed_seq)
    return SessionView(
        key=SessionKey(record.map_id, record.session_id),
        robot_id=record.robot_id,
        state=SessionState(record.state),
        committed_seq=record.committed_seq,
        travelled_m=record.travelled_m,
        submap_count=uow.submaps.count(record.tenant, map_id=record.map_id, session_id=record.session_id),
        created_at_ns=record.created_at_ns,
        finished_at_ns=record.finished_at_ns,
        committed_stamp_ns=None if last is None else last.stamp_ns,
    )


__all__ = ["CreateSession", "CreatedSession", "SessionState", "SessionView", "Sessions"]
