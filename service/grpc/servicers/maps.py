"""MapService."""

from __future__ import annotations

from typing import Any

from revisit.service.application import UseCases
from revisit.service.grpc.tenancy import tenant_of
from revisit.service.wire import answers, names, requests
from revisit.service.wire.rendering import page_message
from revisit.v1 import map_pb2 as pb
from revisit.v1 import map_pb2_grpc


class MapServicer(map_pb2_grpc.MapServiceServicer):
    """Create, get, list and delete maps."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._maps = use_cases.maps

    async def CreateMap(self, request: pb.CreateMapRequest, context: Any) -> pb.CreateMapResponse:
        """Create a map."""
        created = await self._maps.create(tenant_of(context), requests.create_map(request))
        return pb.CreateMapResponse(map=answers.of_map(created.map), replay=created.replay)

    async def GetMap(self, request: pb.GetMapRequest, context: Any) -> pb.GetMapResponse:
        """Get a map."""
        view = await self._maps.get(tenant_of(context), names.map_id(request.name))
        return pb.GetMapResponse(map=answers.of_map(view))

    async def ListMaps(self, request: pb.ListMapsRequest, context: Any) -> pb.ListMapsResponse:
        """List the maps."""
        page = await self._maps.list(tenant_of(context), requests.page(request))
        return await page_message(pb.ListMapsResponse, "maps", page, answers.of_map)

    async def DeleteMap(self, request: pb.DeleteMapRequest, context: Any) -> pb.DeleteMapResponse:
        """Delete a map."""
        await self._maps.delete(tenant_of(context), names.map_id(request.name))
        return pb.DeleteMapResponse()
