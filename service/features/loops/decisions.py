"""Decisions of people on loop closures: accept, reject, take back, make one by hand; and the history of each loop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4, pose_row
from revisit.service.domain.callers import current_actor
from revisit.service.domain.errors import AlreadyExists, NotReady
from revisit.service.domain.events import AWAITS_CHAIN
from revisit.service.domain.identity import SessionKey, SubmapKey, TenantId, content_hash, validated_note
from revisit.service.domain.records import JobRecord, LoopEventRecord, LoopRecord, SubmapRecord
from revisit.service.domain.states import LoopEventKind, LoopState, OperationKind, SubmapState
from revisit.service.features.audit import calls as audit
from revisit.service.features.graph.edits import note_edit
from revisit.service.features.graph.posting import optimise_soon
from revisit.service.features.loops.calls import LoopClosureView, loop_seen, require_loop
from revisit.service.features.loops.rows import Change, add_loop, before_last_decision, change_loop
from revisit.service.features.loops.waiting import accept_decided
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, as_it_is
from revisit.service.ports.storage import require_descriptor, require_job, require_map, require_submap
from revisit.service.ports.transactions import UnitOfWork

OVERRULED = "OVERRULED"
"""The reason of a loop that a person has rejected."""

BY_HAND = "by hand"
"""The `start`, in the history of a loop and in the audit log, of a registration from a pose that a caller named."""


@dataclass(frozen=True)
class ProposeLoop:
    """A loop that a person has found between two submaps; `T_match_query` (4, 4) is roughly how they lie, if known."""

    query: SubmapKey
    match: SubmapKey
    T_match_query: Matrix4 | None = None
    note: str = ""


@dataclass(frozen=True)
class ProposedLoop:
    """The loop, the operation that verifies it, and whether an earlier identical request had made it."""

    loop: LoopClosureView
    operation: JobRecord
    replay: bool


class LoopDecisions:
    """People's decisions about loop closures."""

    def __init__(self, context: CallContext) -> None:
        """Loops made by hand are verified by jobs."""
        self._context = context

    async def accept(self, tenant: TenantId, map_id: str, loop_id: str, note: str = "") -> LoopClosureView:
        """Accept a loop of any verdict. Raises NotFound; BadField where it has no alignment; Draining."""
        return await self._decide(tenant, map_id, loop_id, LoopEventKind.ACCEPTED, note)

    async def reject(self, tenant: TenantId, map_id: str, loop_id: str, note: str = "") -> LoopClosureView:
        """Reject a loop: the map does not rest on it. Raises NotFound, Draining."""
        return await self._decide(tenant, map_id, loop_id, LoopEventKind.REJECTED, note)

    async def revert(self, tenant: TenantId, map_id: str, loop_id: str, note: str = "") -> LoopClosureView:
        """Take back the last decision that holds. Raises NotFound; BadField where nobody has decided; Draining."""
        return await self._decide(tenant, map_id, loop_id, LoopEventKind.REVERTED, note)

    async def propose(self, tenant: TenantId, command: ProposeLoop) -> ProposedLoop:
        """Store a loop that a person has found, for a worker to verify; the same again answers again.

        Raises NotFound; NotReady where a submap is not described; BadField; BadTransform; AlreadyExists where another
        loop by hand between the two waits or is accepted; WorkersBusy; Draining.
        """
        self._context.admission.require_running()
        validated_note(command.note)
        if command.query == command.match or command.query.map_id != command.match.map_id:
            raise BadField("a loop joins two submaps of one map", field="match")
        T = None if command.T_match_query is None else se3.validated(command.T_match_query)
        actor = current_actor()
        return await self._context.storage.write(
            partial(self._propose, tenant=tenant, command=command, T=T, actor=actor)
        )

    async def events(self, tenant: TenantId, map_id: str, loop_id: str, page: PageRequest) -> Page[LoopEventRecord]:
        """The changes of a loop, oldest first. Raises NotFound."""
        find = partial(_events, tenant=tenant, map_id=map_id, loop_id=loop_id)
        return await self._context.lists.page(tenant, page, find, as_it_is)

    async def _decide(
        self, tenant: TenantId, map_id: str, loop_id: str, kind: LoopEventKind, note: str
    ) -> LoopClosureView:
        self._context.admission.require_running()
        change = Change(kind, self._context.clock.wall_ns(), current_actor(), validated_note(note))
        decided = await self._context.storage.write(
            partial(self._change, tenant=tenant, map_id=map_id, loop_id=loop_id, change=change)
        )
        # Its number came with the commit.
        stored = await self._context.storage.read(lambda uow: uow.loops.numbered(tenant, [decided.number]))
        return replace(decided, seq=stored.get(decided.number, decided).seq)

    def _change(self, uow: UnitOfWork, tenant: TenantId, map_id: str, loop_id: str, change: Change) -> LoopClosureView:
        require_map(uow, tenant, map_id, hold=True)
        loop = require_loop(uow, tenant, map_id, loop_id)
        fields = _fields_after(uow, loop, change.kind)
        if fields["state"] == loop.state and change.kind is not LoopEventKind.REVERTED:
            return loop_seen(uow, loop)
        changed = change_loop(uow, loop, change, graph_state=None, **fields)
        if changed.reason == AWAITS_CHAIN:
            accept_decided(uow, tenant, SessionKey(map_id, changed.query_session_id), change.at_ns)
            changed = require_loop(uow, tenant, map_id, loop_id)
        _note(uow, changed, change, _start_of(uow, loop) if loop.manual else None)
        note_edit(uow, tenant, map_id)
        optimise_soon(uow, tenant, map_id, self._context.policy, change.at_ns, decided=True)
        return loop_seen(uow, changed)

    def _propose(
        self, uow: UnitOfWork, tenant: TenantId, command: ProposeLoop, T: Matrix4 | None, actor: str
    ) -> ProposedLoop:
        require_map(uow, tenant, command.query.map_id)
        query, match = (_described(uow, tenant, key) for key in (command.query, command.match))
        known = _by_hand(uow, tenant, query, match)
        near = None if T is None else T.astype("<f8").tobytes()
        asked = content_hash([query.number, match.number, near, command.note])
        if known:
            first = uow.loop_events.find(tenant, limit=1, map_id=query.map_id, loop_id=known[-1].loop_id)[0]
            if first.details["content_hash"] == asked:
                job = require_job(uow, tenant, str(first.details["operation"]))
                return ProposedLoop(loop_seen(uow, known[-1]), job, replay=True)
            if known[-1].state != LoopState.REJECTED:
                raise AlreadyExists(f"loop {known[-1].loop_id} joins the two submaps already")
        loop = _new_loop(query, match, len(known) + 1, T, self._context.clock.wall_ns())
        return self._post(uow, loop, Change(LoopEventKind.PROPOSED, loop.created_at_ns, actor, command.note), asked)

    def _post(self, uow: UnitOfWork, loop: LoopRecord, change: Change, asked: str) -> ProposedLoop:
        """Store a new loop and the job that verifies it, each of which names the other."""
        subject = f"maps/{loop.map_id}/loopClosures/{loop.loop_id}"
        payload = {"map_id": loop.map_id, "loop_id": loop.loop_id}
        job = self._context.jobs.post(uow, loop.tenant, OperationKind.VERIFY_LOOP, subject, payload)
        start = None if loop.T_match_query is None else BY_HAND
        details = {"content_hash": asked, "operation": job.operation_id, **_told(start)}
        added = add_loop(uow, loop, replace(change, details=details))
        _note(uow, loop, change, start)
        return ProposedLoop(loop_seen(uow, added), job, replay=False)


def _fields_after(uow: UnitOfWork, loop: LoopRecord, kind: LoopEventKind) -> dict[str, Any]:
    """State and reason of a loop after a decision of this kind. Raises BadField where it cannot be made."""
    if kind is LoopEventKind.ACCEPTED:
        if loop.T_match_query is None:
            raise BadField("a loop without an alignment cannot be accepted: make one by hand", field="name")
        return {"state": LoopState.ACCEPTED.value, "reason": None}
    if kind is LoopEventKind.REJECTED:
        return {"state": LoopState.REJECTED.value, "reason": OVERRULED}
    before = before_last_decision(uow.loop_events.find(loop.tenant, map_id=loop.map_id, loop_id=loop.loop_id))
    if before is None:
        raise BadField("nobody has decided on this loop", field="name")
    return {"state": before.state.value, "reason": before.reason}


def _described(uow: UnitOfWork, tenant: TenantId, key: SubmapKey) -> SubmapRecord:
    record = require_submap(uow, tenant, key)
    if record.state != SubmapState.DESCRIBED:
        require_descriptor(record)
        raise NotReady(f"submap {key.submap_id} is not described")
    return record


def _by_hand(uow: UnitOfWork, tenant: TenantId, query: SubmapRecord, match: SubmapRecord) -> list[LoopRecord]:
    """The loops that people have made between two submaps, whichever of them is the query, oldest first."""
    found = uow.loops.find(tenant, query_number=query.number, match_number=match.number)
    found += uow.loops.find(tenant, query_number=match.number, match_number=query.number)
    return sorted((loop for loop in found if loop.manual), key=lambda loop: loop.number)


def _new_loop(query: SubmapRecord, match: SubmapRecord, ordinal: int, T: Matrix4 | None, now_ns: int) -> LoopRecord:
    return LoopRecord.between(
        query,
        match,
        loop_id=f"manual-{query.number}-{match.number}-{ordinal}",
        state=LoopState.PROPOSED.value,
        reason=None,
        similarity=0.0,
        score=0.0,
        T_match_query=None if T is None else pose_row(T),
        evidence={},
        created_at_ns=now_ns,
        manual=True,
    )


def _note(uow: UnitOfWork, loop: LoopRecord, change: Change, start: str | None) -> None:
    """Write a change of a loop into the audit log, with the start of a loop that was made by hand."""
    subject = f"maps/{loop.map_id}/loopClosures/{loop.loop_id}"
    audit.append(uow, change.at_ns, audit.noted(loop.tenant, f"loop_{change.kind.lower()}", subject, **_told(start)))


def _start_of(uow: UnitOfWork, loop: LoopRecord) -> str | None:
    """Where the registration of a loop that was made by hand began; None where the worker sought a start."""
    first = uow.loop_events.find(loop.tenant, limit=1, map_id=loop.map_id, loop_id=loop.loop_id)
    return first[0].details.get("start") if first else None


def _told(start: str | None) -> dict[str, str]:
    return {} if start is None else {"start": start}


def _events(
    uow: UnitOfWork, after: int, limit: int, tenant: TenantId, map_id: str, loop_id: str
) -> list[LoopEventRecord]:
    require_loop(uow, tenant, map_id, loop_id)
    return uow.loop_events.find(tenant, after=after, limit=limit, map_id=map_id, loop_id=loop_id)
