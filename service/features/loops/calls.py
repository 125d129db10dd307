"""Loop closures: pairs of submaps that look alike, with the verdict of geometric verification and its evidence."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.core.pose_graph.graph import GraphState
from revisit.service.domain.errors import NotFound
from revisit.service.domain.identity import SessionKey, SubmapKey, TenantId
from revisit.service.domain.records import LoopRecord
from revisit.service.domain.states import LoopState
from revisit.service.features.graph.map_frames import LoopInMap, MapFrames
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest
from revisit.service.features.waiting.event_tail import EventTail
from revisit.service.features.waiting.freshness import Freshness, ReadYourWrites
from revisit.service.ports.storage import require_map, require_session
from revisit.service.ports.transactions import UnitOfWork

_LAST_NUMBER = 2**63 - 1
"""No closure has a larger number; stores cannot compare with one."""

_WATCH_BATCH = 100


@dataclass(frozen=True)
class LoopClosureView:
    """A loop closure as clients see it.

    `T_match_query` (4, 4) maps points of the query submap's frame into the match submap's frame, None where the
    candidate was rejected before an alignment existed; `reason` says which gate rejected it; `evidence` holds the
    measurements (inliers, overlap, residual, covariance), and the model version as JSON.
    `number` grows with every closure of the service: it orders them and resumes a watch. `graph_state` is the verdict
    of the version of the map in force, `in_map` where that has both submaps in one frame; `manual`: a person made it.
    """

    loop_id: str
    number: int
    map_id: str
    query: SubmapKey
    match: SubmapKey
    state: LoopState
    reason: str | None
    similarity: float
    score: float
    T_match_query: Matrix4 | None
    evidence: dict[str, Any]
    created_at_ns: int
    graph_state: GraphState | None = None
    manual: bool = False
    in_map: LoopInMap | None = None

    @property
    def name(self) -> str:
        """The resource name."""
        return f"maps/{self.map_id}/loopClosures/{self.loop_id}"


class Loops:
    """Get, list and watch loop closures."""

    def __init__(self, context: CallContext, tail: EventTail, writes: ReadYourWrites) -> None:
        """`tail` sees that there is news; `writes` waits for what an answer must know."""
        self._context = context
        self._tail = tail
        self._writes = writes

    async def get(self, tenant: TenantId, map_id: str, loop_id: str) -> LoopClosureView:
        """Raises NotFound."""
        return await self._context.storage.read(partial(_seen, tenant=tenant, map_id=map_id, loop_id=loop_id))

    async def list(
        self,
        tenant: TenantId,
        map_id: str,
        page: PageRequest,
        state: LoopState | None = None,
        session_id: str | None = None,
        fresh: Freshness = Freshness(),
        graph_state: GraphState | None = None,
        reason: str | None = None,
    ) -> Page[LoopClosureView]:
        """The closures of a map, oldest first; `session_id` keeps those with a query submap of that session.

        `reason` keeps those that were rejected for it.

        Raises NotFound for the map and the session, SeqNotReached where `fresh` was not reached.
        """
        await self._writes.reached(tenant, map_id, replace(fresh, loops=True))
        wanted = Wanted(map_id, state, session_id, graph_state, reason or None)
        find = partial(_views, tenant=tenant, wanted=wanted)
        return await self._context.lists.page(tenant, page, find, lambda _, view: view)

    async def watch(
        self, tenant: TenantId, map_id: str, after: int = 0, session_id: str | None = None
    ) -> AsyncIterator[LoopClosureView]:
        """The accepted closures with a number above `after`, those to come too, until the caller stops.

        Ends when the service stops. Raises NotFound for the map and the session.
        """
        seen = min(after, _LAST_NUMBER)
        while not self._context.admission.stopping:
            looked_at = self._tail.last
            views = await self._accepted_after(tenant, map_id, seen, session_id)
            for view in views:
                seen = view.number
                yield view
            if not views:
                await self._tail.beyond(tenant, map_id, looked_at)

    async def _accepted_after(
        self, tenant: TenantId, map_id: str, after: int, session_id: str | None
    ) -> Sequence[LoopClosureView]:
        wanted = Wanted(map_id, LoopState.ACCEPTED, session_id)
        return await self._context.storage.read(
            partial(_views, tenant=tenant, wanted=wanted, after=after, limit=_WATCH_BATCH)
        )


@dataclass(frozen=True)
class Wanted:
    """Which loop closures of a map: in a state, of a session, with a verdict of the graph, for a reason."""

    map_id: str
    state: LoopState | None = None
    session_id: str | None = None
    graph_state: GraphState | None = None
    reason: str | None = None

    def equals(self) -> dict[str, Any]:
        """The fields that a row must have."""
        asked = {
            "map_id": self.map_id,
            "state": self.state,
            "query_session_id": self.session_id,
            "graph_state": self.graph_state,
            "reason": self.reason,
        }
        return {name: str(value) for name, value in asked.items() if value is not None}


def loop_view(record: LoopRecord, in_map: LoopInMap | None = None) -> LoopClosureView:
    """The client's view of a loop closure."""
    return LoopClosureView(
        loop_id=record.loop_id,
        number=record.number,
        map_id=record.map_id,
        query=SubmapKey(record.map_id, record.query_session_id, record.query_submap_id),
        match=SubmapKey(record.map_id, record.match_session_id, record.match_submap_id),
        state=LoopState(record.state),
        reason=record.reason,
        similarity=record.similarity,
        score=record.score,
        T_match_query=None if record.T_match_query is None else pose_matrix(record.T_match_query),
        evidence=record.evidence,
        created_at_ns=record.created_at_ns,
        graph_state=None if record.graph_state is None else GraphState(record.graph_state),
        manual=record.manual,
        in_map=in_map,
    )


def loop_seen(uow: UnitOfWork, record: LoopRecord) -> LoopClosureView:
    """The client's view of a loop closure, with where the map has it."""
    in_map = MapFrames(uow, record.tenant, record.map_id).loops([record])
    return loop_view(record, in_map.get(record.number))


def _seen(uow: UnitOfWork, tenant: TenantId, map_id: str, loop_id: str) -> LoopClosureView:
    return loop_seen(uow, require_loop(uow, tenant, map_id, loop_id))


def require_loop(uow: UnitOfWork, tenant: TenantId, map_id: str, loop_id: str) -> LoopRecord:
    """The loop closure. Raises NotFound."""
    record = uow.loops.get(tenant, map_id, loop_id)
    if record is None:
        raise NotFound(f"there is no loop closure {loop_id!r} in map {map_id!r}"[:300])
    return record


def _views(uow: UnitOfWork, after: int, limit: int, *, tenant: TenantId, wanted: Wanted) -> list[LoopClosureView]:
    require_map(uow, tenant, wanted.map_id)
    if wanted.session_id is not None:
        require_session(uow, tenant, SessionKey(wanted.map_id, wanted.session_id))
    records = uow.loops.find(tenant, after=after, limit=limit, **wanted.equals())
    in_map = MapFrames(uow, tenant, wanted.map_id).loops(records)
    return [loop_view(record, in_map.get(record.number)) for record in records]
