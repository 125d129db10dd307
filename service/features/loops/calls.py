"""Loop closures: pairs of submaps that look alike, with the verdict of geometric verification and its evidence."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self

from revisit.core.pose_graph.graph import GraphState
from revisit.service.domain.errors import NotFound
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.records import LoopRecord
from revisit.service.domain.states import LoopState
from revisit.service.features.graph.map_frames import LoopInMap, MapFrames
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, as_it_is
from revisit.service.features.waiting.event_tail import EventTail
from revisit.service.features.waiting.freshness import Freshness, ReadYourWrites
from revisit.service.ports.storage import require_map, require_session
from revisit.service.ports.transactions import UnitOfWork

_LAST_NUMBER = 2**63 - 1
"""No closure has a larger number; stores cannot compare with one."""

_WATCH_BATCH = 100


@dataclass(frozen=True, kw_only=True)
class LoopClosureView(LoopRecord):
    """A loop closure; `in_map` is there where the version of the map in force has both submaps in one frame."""

    in_map: LoopInMap | None = None

    @classmethod
    def of(cls, record: LoopRecord, in_map: LoopInMap | None = None) -> Self:
        """The view of a row."""
        return cls(**vars(record), in_map=in_map)


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
        return await self._context.lists.page(tenant, page, find, as_it_is)

    async def watch(
        self, tenant: TenantId, map_id: str, after: int = 0, session_id: str | None = None
    ) -> AsyncIterator[LoopClosureView]:
        """The accepted closures with a `seq` above `after`, those to come too, until the caller stops.

        One that is rejected and accepted again is told again. Ends when the service stops. Raises NotFound for the map
        and the session.
        """
        seen, happened = min(after, _LAST_NUMBER), 0
        while not self._context.admission.stopping:
            views = await self._accepted_after(tenant, map_id, seen, session_id)
            for view in views:
                seen = view.seq
                yield view
            if not views:
                happened = await self._tail.beyond(tenant, map_id, happened)

    async def _accepted_after(
        self, tenant: TenantId, map_id: str, after: int, session_id: str | None
    ) -> Sequence[LoopClosureView]:
        wanted = Wanted(map_id, session_id=session_id)
        return await self._context.storage.read(partial(_accepted, tenant=tenant, wanted=wanted, after=after))


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


def loop_seen(uow: UnitOfWork, record: LoopRecord) -> LoopClosureView:
    """The client's view of a loop closure, with where the map has it."""
    in_map = MapFrames(uow, record.tenant, record.map_id).loops([record])
    return LoopClosureView.of(record, in_map.get(record.number))


def _seen(uow: UnitOfWork, tenant: TenantId, map_id: str, loop_id: str) -> LoopClosureView:
    return loop_seen(uow, require_loop(uow, tenant, map_id, loop_id))


def require_loop(uow: UnitOfWork, tenant: TenantId, map_id: str, loop_id: str) -> LoopRecord:
    """The loop closure. Raises NotFound."""
    record = uow.loops.get(tenant, map_id, loop_id)
    if record is None:
        raise NotFound(f"there is no loop closure {loop_id!r} in map {map_id!r}"[:300])
    return record


def _views(uow: UnitOfWork, after: int, limit: int, *, tenant: TenantId, wanted: Wanted) -> list[LoopClosureView]:
    _require(uow, tenant, wanted)
    return _in_map(uow, tenant, wanted, uow.loops.find(tenant, after=after, limit=limit, **wanted.equals()))


def _accepted(uow: UnitOfWork, tenant: TenantId, wanted: Wanted, after: int) -> list[LoopClosureView]:
    _require(uow, tenant, wanted)
    accepted = uow.loops.accepted(tenant, after=after, limit=_WATCH_BATCH, **wanted.equals())
    return _in_map(uow, tenant, wanted, accepted)


def _require(uow: UnitOfWork, tenant: TenantId, wanted: Wanted) -> None:
    """Raises NotFound for the map and the session."""
    require_map(uow, tenant, wanted.map_id)
    if wanted.session_id is not None:
        require_session(uow, tenant, SessionKey(wanted.map_id, wanted.session_id))


def _in_map(uow: UnitOfWork, tenant: TenantId, wanted: Wanted, records: Sequence[LoopRecord]) -> list[LoopClosureView]:
    in_map = MapFrames(uow, tenant, wanted.map_id).loops(records)
    return [LoopClosureView.of(record, in_map.get(record.number)) for record in records]
