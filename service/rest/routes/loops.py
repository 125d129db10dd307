"""`/v1/maps/{map}/loopClosures`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from revisit.service.application.access.callers import Scope
from revisit.service.application.contract import limits
from revisit.service.application.contract.states import GraphState, LoopState
from revisit.service.rest.access import allows
from revisit.service.rest.answers import LoopClosure, LoopClosurePage, answer, answers, page_answer
from revisit.service.rest.parameters import Cases, Fresh, Id, Paging, Tenant
from revisit.service.wire.answers import of_loop

router = APIRouter(prefix="/v1/maps/{map_id}/loopClosures", tags=["loop closures"])


@router.get("", **answers(LoopClosurePage), dependencies=[allows(Scope.QUERY)])
async def list_loop_closures(
    map_id: Id,
    cases: Cases,
    tenant: Tenant,
    paging: Paging,
    fresh: Fresh,
    state: LoopState | None = None,
    session_id: Annotated[str | None, Query(max_length=limits.ID_CHARACTERS)] = None,
    graph_state: GraphState | None = None,
    reason: Annotated[str | None, Query(max_length=limits.REASON_CHARACTERS)] = None,
) -> Response:
    """List the loop closures of a map with their evidence, oldest first."""
    page = await cases.loops.list(tenant, map_id, paging, state, session_id, fresh, graph_state, reason)
    return await page_answer(LoopClosurePage, "loop_closures", page, of_loop)


@router.get("/{loop_id}", **answers(LoopClosure), dependencies=[allows(Scope.QUERY)])
async def get_loop_closure(map_id: Id, loop_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Get a loop closure with its evidence."""
    return answer(LoopClosure, of_loop(await cases.loops.get(tenant, map_id, loop_id)))
