"""`/v1/maps/{map}/loopClosures`."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Response

from revisit.service.application.access.callers import Scope
from revisit.service.application.contract import limits
from revisit.service.application.contract.states import GraphState, LoopState
from revisit.service.application.mapping.loop_decisions import ProposeLoop
from revisit.service.rest.access import allows
from revisit.service.rest.answers import (
    LoopClosure,
    LoopClosureEventPage,
    LoopClosurePage,
    LoopKeypoints,
    ProposedLoop,
    answer,
    answers,
    page_answer,
)
from revisit.service.rest.bodies import describe_json, json_body
from revisit.service.rest.parameters import Cases, Fresh, Id, Paging, Tenant, pose
from revisit.service.rest.schemas import CreateLoopClosureRequest, DecisionRequest
from revisit.service.wire import names
from revisit.service.wire.answers import of_loop, of_loop_event, of_loop_keypoints, of_proposed_loop

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
    """List the loop closures of a map with their evidence, oldest first; without `state`, rejected ones too."""
    page = await cases.loops.list(tenant, map_id, paging, state, session_id, fresh, graph_state, reason)
    return await page_answer(LoopClosurePage, "loop_closures", page, of_loop)


@router.post(
    "",
    **answers(ProposedLoop, 201),
    openapi_extra=describe_json(CreateLoopClosureRequest),
    dependencies=[allows(Scope.ADMIN)],
)
async def create_loop_closure(
    map_id: Id,
    body: Annotated[CreateLoopClosureRequest, json_body(CreateLoopClosureRequest)],
    cases: Cases,
    tenant: Tenant,
) -> Response:
    """A loop closure that a person has found: a worker registers its two submaps. The same again answers again."""
    query = names.submap_key_in(f"maps/{map_id}", body.query, "query")
    match = names.submap_key_in(f"maps/{map_id}", body.match, "match")
    near = None if body.T_match_query is None else pose(body.T_match_query, "T_match_query")
    proposed = await cases.loop_decisions.propose(tenant, ProposeLoop(query, match, near, body.note))
    return answer(ProposedLoop, of_proposed_loop(proposed), 201, replay=proposed.replay)


_DECISION: dict[str, Any] = {
    **answers(LoopClosure),
    "openapi_extra": describe_json(DecisionRequest),
    "dependencies": [allows(Scope.ADMIN)],
}
Decision = Annotated[DecisionRequest, json_body(DecisionRequest)]


@router.post("/{loop_id}:accept", **_DECISION)
async def accept_loop_closure(map_id: Id, loop_id: Id, body: Decision, cases: Cases, tenant: Tenant) -> Response:
    """Accept a loop closure whatever its verdict was, or leave it as it is where it is accepted."""
    return answer(LoopClosure, of_loop(await cases.loop_decisions.accept(tenant, map_id, loop_id, body.note)))


@router.post("/{loop_id}:reject", **_DECISION)
async def reject_loop_closure(map_id: Id, loop_id: Id, body: Decision, cases: Cases, tenant: Tenant) -> Response:
    """Reject a loop closure, so that the map does not rest on it."""
    return answer(LoopClosure, of_loop(await cases.loop_decisions.reject(tenant, map_id, loop_id, body.note)))


@router.post("/{loop_id}:revert", **_DECISION)
async def revert_loop_closure(map_id: Id, loop_id: Id, body: Decision, cases: Cases, tenant: Tenant) -> Response:
    """Take back the last decision of a person on a loop closure: it is what it was before."""
    return answer(LoopClosure, of_loop(await cases.loop_decisions.revert(tenant, map_id, loop_id, body.note)))


@router.get("/{loop_id}/events", **answers(LoopClosureEventPage), dependencies=[allows(Scope.QUERY)])
async def list_loop_closure_events(map_id: Id, loop_id: Id, cases: Cases, tenant: Tenant, paging: Paging) -> Response:
    """What happened to a loop closure, by whom and why, oldest first."""
    page = await cases.loop_decisions.events(tenant, map_id, loop_id, paging)
    return await page_answer(LoopClosureEventPage, "loop_closure_events", page, of_loop_event)


@router.get("/{loop_id}/keypoints", **answers(LoopKeypoints), dependencies=[allows(Scope.QUERY)])
async def get_loop_closure_keypoints(map_id: Id, loop_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """The keypoints of both submaps seen from above, which look alike, and which of these the pose joins."""
    return answer(LoopKeypoints, of_loop_keypoints(await cases.loop_keypoints.of(tenant, map_id, loop_id)))


@router.get("/{loop_id}", **answers(LoopClosure), dependencies=[allows(Scope.QUERY)])
async def get_loop_closure(map_id: Id, loop_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Get a loop closure with its evidence."""
    return answer(LoopClosure, of_loop(await cases.loops.get(tenant, map_id, loop_id)))
