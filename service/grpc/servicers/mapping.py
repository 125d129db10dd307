"""MappingService."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

from revisit.service.application import UseCases
from revisit.service.grpc.tenancy import tenant_of
from revisit.service.wire import answers, names, requests
from revisit.v1 import mapping_pb2 as pb
from revisit.v1 import mapping_pb2_grpc


class MappingServicer(mapping_pb2_grpc.MappingServiceServicer):
    """Optimise and merge maps, look at their versions, bring one back; get and watch corrections."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._versions = use_cases.map_versions
        self._merges = use_cases.map_merges
        self._corrections = use_cases.corrections

    async def OptimiseMap(self, request: pb.OptimiseMapRequest, context: Any) -> pb.OptimiseMapResponse:
        """Queue the optimisation of a map."""
        posted = await self._versions.optimise(tenant_of(context), names.map_id(request.name))
        return pb.OptimiseMapResponse(operation=answers.of_operation(posted.operation), replay=posted.replay)

    async def ListMapVersions(self, request: pb.ListMapVersionsRequest, context: Any) -> pb.ListMapVersionsResponse:
        """List the versions of a map."""
        map_id, paging = names.map_id(request.parent, "parent"), requests.page(request)
        page = await self._versions.list(tenant_of(context), map_id, paging)
        return pb.ListMapVersionsResponse(**answers.of_page("map_versions", page, answers.of_map_version))

    async def GetMapVersion(self, request: pb.GetMapVersionRequest, context: Any) -> pb.GetMapVersionResponse:
        """Get a version of a map."""
        view = await self._versions.get(tenant_of(context), *names.version_key(request.name))
        return pb.GetMapVersionResponse(map_version=answers.of_map_version(view))

    async def ListSubmapPoses(self, request: pb.ListSubmapPosesRequest, context: Any) -> pb.ListSubmapPosesResponse:
        """The poses of a version of a map."""
        key, paging = names.version_key(request.parent, "parent"), requests.page(request)
        page = await self._versions.poses(tenant_of(context), *key, paging)
        return pb.ListSubmapPosesResponse(**answers.of_page("submap_poses", page, answers.of_submap_pose))

    async def RevertMap(self, request: pb.RevertMapRequest, context: Any) -> pb.RevertMapResponse:
        """Bring back an earlier version of a map."""
        view = await self._versions.revert(tenant_of(context), names.map_id(request.name), request.version)
        return pb.RevertMapResponse(map_version=answers.of_map_version(view))

    async def MergeMap(self, request: pb.MergeMapRequest, context: Any) -> pb.MergeMapResponse:
        """Merge another map, or a session of it, into a map."""
        posted = await self._merges.merge(tenant_of(context), requests.merge_map(request))
        return pb.MergeMapResponse(operation=answers.of_operation(posted.operation), replay=posted.replay)

    async def ListMapMerges(self, request: pb.ListMapMergesRequest, context: Any) -> pb.ListMapMergesResponse:
        """List the merges into a map."""
        map_id, paging = names.map_id(request.parent, "parent"), requests.page(request)
        page = await self._merges.list(tenant_of(context), map_id, paging)
        return pb.ListMapMergesResponse(**answers.of_page("map_merges", page, answers.of_map_merge))

    async def GetMapMerge(self, request: pb.GetMapMergeRequest, context: Any) -> pb.GetMapMergeResponse:
        """Get a merge into a map."""
        view = await self._merges.get(tenant_of(context), *names.merge_key(request.name))
        return pb.GetMapMergeResponse(map_merge=answers.of_map_merge(view))

    async def RevertMapMerge(self, request: pb.RevertMapMergeRequest, context: Any) -> pb.RevertMapMergeResponse:
        """Take a merge back."""
        view = await self._merges.revert(tenant_of(context), *names.merge_key(request.name))
        return pb.RevertMapMergeResponse(map_merge=answers.of_map_merge(view))

    async def GetCorrection(self, request: pb.GetCorrectionRequest, context: Any) -> pb.GetCorrectionResponse:
        """Where the odometry frame of a session lies in the map."""
        view = await self._corrections.get(tenant_of(context), names.session_key(request.name))
        return pb.GetCorrectionResponse(correction=answers.of_correction(view))

    async def WatchCorrections(
        self, request: pb.WatchCorrectionsRequest, context: Any
    ) -> AsyncIterator[pb.WatchCorrectionsResponse]:
        """The corrections of a map, those to come too."""
        map_id = names.map_id(request.parent, "parent")
        session_id = names.session_id_in(request.parent, request.session, "session")
        async for view in self._corrections.watch(tenant_of(context), map_id, request.after, session_id):
            yield pb.WatchCorrectionsResponse(correction=answers.of_correction(view))
