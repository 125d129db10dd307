"""LoopClosureService."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

from revisit.core.errors import BadField
from revisit.service.application import TenantId, UseCases
from revisit.service.application.query.search_answers import SearchResult
from revisit.service.grpc.tenancy import tenant_of
from revisit.service.wire import answers, names, requests
from revisit.service.wire.rendering import page_message
from revisit.v1 import loop_closure_pb2 as pb
from revisit.v1 import loop_closure_pb2_grpc


class LoopClosureServicer(loop_closure_pb2_grpc.LoopClosureServiceServicer):
    """Search, localise; get, list and watch loop closures."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._loops = use_cases.loops
        self._searches = use_cases.searches
        self._decisions = use_cases.loop_decisions
        self._keypoints = use_cases.loop_keypoints

    async def SearchSubmaps(self, request: pb.SearchSubmapsRequest, context: Any) -> pb.SearchSubmapsResponse:
        """The submaps most like a submap, a descriptor or a cloud."""
        return pb.SearchSubmapsResponse(**answers.of_search(await self._search(tenant_of(context), request)))

    async def Localize(self, request: pb.LocalizeRequest, context: Any) -> pb.LocalizeResponse:
        """Where in the map the cloud was taken, if the place is known."""
        query, fresh = requests.localize(request), requests.freshness(request)
        answer = await self._searches.localize(tenant_of(context), query, fresh)
        return pb.LocalizeResponse(**answers.of_localization(answer))

    async def GetLoopClosure(self, request: pb.GetLoopClosureRequest, context: Any) -> pb.GetLoopClosureResponse:
        """Get a loop closure."""
        view = await self._loops.get(tenant_of(context), *names.loop_key(request.name))
        return pb.GetLoopClosureResponse(loop_closure=answers.of_loop(view))

    async def ListLoopClosures(self, request: pb.ListLoopClosuresRequest, context: Any) -> pb.ListLoopClosuresResponse:
        """List the loop closures of a map."""
        map_id = names.map_id(request.parent, "parent")
        session_id = names.session_id_in(request.parent, request.session, "session")
        paging, state, fresh = requests.page(request), requests.loop_state(request.state), requests.freshness(request)
        graph_state = requests.graph_state(request.graph_state)
        page = await self._loops.list(
            tenant_of(context), map_id, paging, state, session_id, fresh, graph_state, request.reason
        )
        return await page_message(pb.ListLoopClosuresResponse, "loop_closures", page, answers.of_loop)

    async def WatchLoopClosures(
        self, request: pb.WatchLoopClosuresRequest, context: Any
    ) -> AsyncIterator[pb.WatchLoopClosuresResponse]:
        """The accepted loop closures, those to come too."""
        map_id = names.map_id(request.parent, "parent")
        session_id = names.session_id_in(request.parent, request.session, "session")
        async for view in self._loops.watch(tenant_of(context), map_id, request.after, session_id):
            yield pb.WatchLoopClosuresResponse(loop_closure=answers.of_loop(view))

    async def CreateLoopClosure(
        self, request: pb.CreateLoopClosureRequest, context: Any
    ) -> pb.CreateLoopClosureResponse:
        """A loop closure that a person has found."""
        proposed = await self._decisions.propose(tenant_of(context), requests.propose_loop(request))
        return pb.CreateLoopClosureResponse(**answers.of_proposed_loop(proposed))

    async def AcceptLoopClosure(
        self, request: pb.AcceptLoopClosureRequest, context: Any
    ) -> pb.AcceptLoopClosureResponse:
        """Accept a loop closure."""
        view = await self._decisions.accept(tenant_of(context), *names.loop_key(request.name), request.note)
        return pb.AcceptLoopClosureResponse(loop_closure=answers.of_loop(view))

    async def RejectLoopClosure(
        self, request: pb.RejectLoopClosureRequest, context: Any
    ) -> pb.RejectLoopClosureResponse:
        """Reject a loop closure."""
        view = await self._decisions.reject(tenant_of(context), *names.loop_key(request.name), request.note)
        return pb.RejectLoopClosureResponse(loop_closure=answers.of_loop(view))

    async def RevertLoopClosure(
        self, request: pb.RevertLoopClosureRequest, context: Any
    ) -> pb.RevertLoopClosureResponse:
        """Take back the last decision on a loop closure."""
        view = await self._decisions.revert(tenant_of(context), *names.loop_key(request.name), request.note)
        return pb.RevertLoopClosureResponse(loop_closure=answers.of_loop(view))

    async def GetLoopClosureKeypoints(
        self, request: pb.GetLoopClosureKeypointsRequest, context: Any
    ) -> pb.GetLoopClosureKeypointsResponse:
        """The keypoints of a loop closure's two submaps."""
        view = await self._keypoints.of(tenant_of(context), *names.loop_key(request.name))
        return pb.GetLoopClosureKeypointsResponse(**answers.of_loop_keypoints(view))

    async def ListLoopClosureEvents(
        self, request: pb.ListLoopClosureEventsRequest, context: Any
    ) -> pb.ListLoopClosureEventsResponse:
        """What happened to a loop closure."""
        key, paging = names.loop_key(request.parent, "parent"), requests.page(request)
        page = await self._decisions.events(tenant_of(context), *key, paging)
        return pb.ListLoopClosureEventsResponse(**answers.of_page("loop_closure_events", page, answers.of_loop_event))

    async def _search(self, tenant: TenantId, request: pb.SearchSubmapsRequest) -> SearchResult:
        map_id, criteria = names.map_id(request.parent, "parent"), requests.criteria(request)
        fresh = requests.freshness(request)
        match request.WhichOneof("query"):
            case "submap":
                key = names.submap_key_in(request.parent, request.submap, "submap")
                return await self._searches.by_submap(tenant, key, criteria, fresh)
            case "place_descriptor":
                vector, version = requests.vector(request.place_descriptor), request.place_descriptor.model_version
                return await self._searches.by_descriptor(tenant, map_id, vector, version, criteria, fresh)
            case "cloud":
                cloud, level = requests.cloud(request.cloud), requests.level_pose(request)
                return await self._searches.by_cloud(tenant, map_id, cloud, criteria, fresh, T_level_query=level)
        raise BadField("give a submap, a descriptor or a cloud", field="query")
