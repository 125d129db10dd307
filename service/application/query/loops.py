"""Loop closures: pairs of submaps that look alike, with the verdict of geometric verification and its evidence."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.service.application.capacity.admission import Admission
from revisit.service.application.catalogue.paging import Lists, Page, PageRequest
from revisit.service.application.contract.errors import NotFound
from revisit.service.application.contract.identity import SessionKey, SubmapKey, TenantId
from revisit.service.application.contract.lookup import require_map, require_session
from revisit.service.application.contract.records import LoopRecord
from revisit.service.application.contract.states import LoopState
from revisit.service.application.contract.storage import Storage
from revisit.service.application.contract.transactions import UnitOfWork
from revisit.service.application.query.freshness import Freshness, await_freshness

_LAST_NUMBER = 2**63 - 1
"""No closure has a larger number; stores cannot compare with one."""

_WATCH_POLL_S = 0.25
_WATCH_BATCH = 100


@dataclass(frozen=True)
class LoopClosureView:
    """A loop closure as clients see it.

    `T_match_query` (4, 4) maps points of the query submap's frame into the match submap's frame, None where the
    candidate was rejected before an alignment existed; `reason` says which gate rejected it; `evidence` holds the
    measurements (inliers, overlap, residual, covariance), and the model version as JSON.
    `number` grows with every closure of the service: it orders them and resumes a watch.
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

    @property
    def name(self) -> str:
        """The resource name."""
        return f"maps/{self.map_id}/loopClosures/{self.loop_id}"


class Loops:
    """Get, list and watch loop closures."""

    def __init__(self, storage: Storage, lists: Lists, admission: Admission) -> None:
        """Watching ends when `admission` says that the service stops."""
        self._storage = storage
        self._lists = lists
        self._admission = admission

    async def get(self, tenant: TenantId, map_id: str, loop_id: str) -> LoopClosureView:
        """Raises NotFound."""
        record = await self._storage.read(partial(_require_loop, tenant=tenant, map_id=map_id, loop_id=loop_id))
        return loop_view(record)

    async def list(
        self,
        tenant: TenantId,
        map_id: str,
        page: PageRequest,
        state: LoopState | None = None,
        session_id: str | None = None,
        fresh: Freshness = Freshness(),
    ) -> Page[LoopClosureView]:
        """The closures of a map, oldest first; `session_id` keeps those whose query submap is of that session.

        Raises NotFound for the map and the session, SeqNotReached where `fresh` was not reached.
        """
        await await_freshness(self._storage, self._admission, tenant, map_id, fresh)
        return await self._lists.page(
            tenant,
            page,
            lambda uow, after, limit: _load(uow, tenant, map_id, after, limit, state, session_id),
            lambda _, record: loop_view(record),
        )

    async def watch(
        self, tenant: TenantId, map_id: str, after: int = 0, session_id: str | None = None
    ) -> AsyncIterator[LoopClosureView]:
        """The accepted closures with a number above `after`, those to come too, until the caller stops.

        Ends when the service stops. Raises NotFound for the map and the session.
        """
        seen = min(after, _LAST_NUMBER)
        while not self._admission.stopping:
            records = await self._accepted_after(tenant, map_id, seen, session_id)
            for record in records:
                seen = record.number
                yield loop_view(record)
            if not records:
                await asyncio.sleep(_WATCH_POLL_S)

    async def _accepted_after(
        self, tenant: TenantId, map_id: str, after: int, session_id: str | None
    ) -> Sequence[LoopRecord]:
        return await self._storage.read(
            lambda uow: _load(uow, tenant, map_id, after, _WATCH_BATCH, LoopState.ACCEPTED, session_id)
        )


def loop_view(record: LoopRecord) -> LoopClosureView:
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
    )


def _require_loop(uow: UnitOfWork, tenant: TenantId, map_id: str, loop_id: str) -> LoopRecord:
    record = uow.loops.get(tenant, map_id, loop_id)
    if record is None:
        raise NotFound(f"there is no loop closure {loop_id!r} in map {map_id!r}"[:300])
    return record


def _load(
    uow: UnitOfWork,
    tenant: TenantId,
    map_id: str,
    after: int,
    limit: int,
    state: LoopState | None,
    session_id: str | None,
) -> list[LoopRecord]:
    require_map(uow, tenant, map_id)
    equals: dict[str, str] = {"map_id": map_id}
    if state is not None:
        equals["state"] = state.value
    if session_id is not None:
        require_session(uow, tenant, SessionKey(map_id, session_id))
        equals["query_session_id"] = session_id
    return uow.loops.find(tenant, after=after, limit=limit, **equals)
