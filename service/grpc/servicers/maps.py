"""MapService."""

from __future__ import annotations

from typing import Any

from revisit.service.application import UseCases
from revisit.service.application.catalogue.maps import CreateMap
from revisit.service.grpc import messages, names
from revisit.service.grpc.tenancy import tenant_of
from revisit.v1 import map_pb2, map_pb2_grpc


class MapServicer(map_pb2_grpc.MapServiceServicer):
    """Create, get, list and delete maps."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._maps = use_cases.maps

    async def CreateMap(self, request: map_pb2.CreateMapRequest, context: Any) -> map_pb2.CreateMapResponse:
        """Create a map."""
        fields = ("tau_m", "stride_m", "min_index_gap", "scene_scale")
        given = {field: getattr(request, field) for field in fields if request.HasField(field)}
        command = CreateMap(request.map_id, request.display_name, **given)
        created = await self._maps.create(tenant_of(context), command)
        return map_pb2.CreateMapResponse(map=messages.map_message(created.map), replay=created.replay)

    async def GetMap(self, request: map_pb2.GetMapRequest, context: Any) -> map_pb2.GetMapResponse:
        """Get a map."""
        view = await self._maps.get(tenant_of(context), names.map_id(request.name))
        return map_pb2.GetMapResponse(map=messages.map_message(view))

    async def ListMaps(self, request: map_pb2.ListMapsRequest, context: Any) -> map_pb2.ListMapsResponse:
        """List the maps."""
        page = await self._maps.list(tenant_of(context), messages.page_request(request))
        items = [messages.map_message(view) for view in page.items]
        return map_pb2.ListMapsResponse(maps=items, next_page_token=page.next_token)

    async def DeleteMap(self, request: map_pb2.DeleteMapRequest, context: Any) -> map_pb2.DeleteMapResponse:
        """Delete a map."""
        await self._maps.delete(tenant_of(context), names.map_id(request.name))
        return map_pb2.DeleteMapResponse()
