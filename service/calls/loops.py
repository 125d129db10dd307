"""Loop closures, and the decisions of people on them."""

from __future__ import annotations

from collections.abc import AsyncIterator

from revisit.core.pose_graph.graph import GraphState
from revisit.service.calls.operations import operation_fields
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import LoopEventRecord
from revisit.service.domain.states import LoopState
from revisit.service.features.graph.map_frames import matrix_of
from revisit.service.features.loops.calls import LoopClosureView
from revisit.service.features.loops.decisions import ProposeLoop
from revisit.service.features.loops.keypoints import KeypointPlan, LoopKeypoints
from revisit.service.use_cases import UseCases
from revisit.service.wire import names, requests
from revisit.service.wire.fields import Fields, fields_in_map, fields_of, transform_fields
from revisit.service.wire.rendering import Answer, Listed
from revisit.v1 import loop_closure_pb2 as pb


async def list_loop_closures(cases: UseCases, tenant: TenantId, request: pb.ListLoopClosuresRequest) -> Answer:
    """The loop closures of a map."""
    page = await cases.loops.list(
        tenant,
        names.map_id(request.parent, "parent"),
        requests.page(request),
        requests.state_of(LoopState, pb.LoopClosure.State, request.state),
        names.session_id_in(request.parent, request.session, "session"),
        requests.freshness(request),
        requests.state_of(GraphState, pb.LoopClosure.GraphState, request.graph_state),
        request.reason,
    )
    return Listed("loop_closures", page, loop_fields)


async def watch_loop_closures(
    cases: UseCases, tenant: TenantId, request: pb.WatchLoopClosuresRequest
) -> AsyncIterator[Fields]:
    """The accepted loop closures, those to come too."""
    map_id = names.map_id(request.parent, "parent")
    session_id = names.session_id_in(request.parent, request.session, "session")
    async for view in cases.loops.watch(tenant, map_id, request.after, session_id):
        yield {"loop_closure": loop_fields(view)}


async def create_loop_closure(cases: UseCases, tenant: TenantId, request: pb.CreateLoopClosureRequest) -> Answer:
    """A loop closure that a person has found, and the operation that verifies it."""
    command = ProposeLoop(
        query=names.submap_key_in(request.parent, request.query, "query"),
        match=names.submap_key_in(request.parent, request.match, "match"),
        T_match_query=requests.optional_pose(request, "t_match_query"),
        note=request.note,
    )
    proposed = await cases.loop_decisions.propose(tenant, command)
    return {
        "loop_closure": loop_fields(proposed.loop),
        "operation": operation_fields(proposed.operation),
        "replay": proposed.replay,
    }


async def get_loop_closure_keypoints(
    cases: UseCases, tenant: TenantId, request: pb.GetLoopClosureKeypointsRequest
) -> Answer:
    """The keypoints of a loop closure's two submaps."""
    return keypoint_fields(await cases.loop_keypoints.of(tenant, *names.loop_key(request.name)))


def loop_fields(view: LoopClosureView) -> Fields:
    """The fields of a LoopClosure."""
    T_map_match = matrix_of(None if view.in_map is None else view.in_map.match)
    return fields_of(
        pb.LoopClosure,
        view,
        number=view.seq,
        query=view.query.name,
        match=view.match.name,
        **fields_in_map("t_map_query", None if view.in_map is None else view.in_map.query),
        t_map_match=None if T_map_match is None else transform_fields(T_map_match),
    )


def loop_event_fields(record: LoopEventRecord) -> Fields:
    """The fields of a LoopClosureEvent."""
    return fields_of(pb.LoopClosureEvent, record)


def keypoint_fields(view: LoopKeypoints) -> Fields:
    """The fields of a GetLoopClosureKeypointsResponse."""
    pairs = zip(view.pairs.tolist(), view.agrees.tolist(), strict=True)
    return {
        "query": _plan_fields(view.query),
        "match": _plan_fields(view.match),
        "pairs": [{"query": query, "match": match, "agrees": agrees} for (query, match), agrees in pairs],
    }


def _plan_fields(plan: KeypointPlan) -> Fields:
    x, y = plan.keypoints.T.round(3).tolist()
    return fields_of(pb.KeypointPlan, plan, submap=plan.submap.name, x=x, y=y)
