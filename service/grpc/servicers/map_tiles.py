"""MapTileService."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

from revisit.service.application import UseCases
from revisit.service.grpc.tenancy import tenant_of
from revisit.service.wire import map_parts, names, requests
from revisit.service.wire.rendering import page_message
from revisit.v1 import map_tile_pb2 as pb
from revisit.v1 import map_tile_pb2_grpc


class MapTileServicer(map_tile_pb2_grpc.MapTileServiceServicer):
    """List and download tiles, measure in them."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._tiles = use_cases.map_tiles
        self._budget = use_cases.budget

    async def ListMapTiles(self, request: pb.ListMapTilesRequest, context: Any) -> pb.ListMapTilesResponse:
        """List the tiles of a version of a map."""
        key, paging = names.version_key(request.parent, "parent"), requests.page(request)
        page = await self._tiles.list(tenant_of(context), *key, paging)
        return await page_message(pb.ListMapTilesResponse, "map_tiles", page, map_parts.of_map_tile)

    async def DownloadMapTile(
        self, request: pb.DownloadMapTileRequest, context: Any
    ) -> AsyncIterator[pb.DownloadMapTileResponse]:
        """A file in chunks; the first one says what it is."""
        key, what = map_parts.tile_key(request.name), map_parts.tile_download(request)
        await self._tiles.make(tenant_of(context), key)
        with self._budget.hold(tenant_of(context)) as held:
            file = await self._tiles.download(tenant_of(context), key, *what, room=held.wait_for)
            held.set(len(file.data))
            yield pb.DownloadMapTileResponse(media_type=file.media_type, filename=file.filename)
            for piece in file.pieces():
                yield pb.DownloadMapTileResponse(data=piece)

    async def MeasureMapDistances(
        self, request: pb.MeasureMapDistancesRequest, context: Any
    ) -> pb.MeasureMapDistancesResponse:
        """Signed distances of points to the surface."""
        found = await self._tiles.distances(tenant_of(context), map_parts.distances(request))
        return pb.MeasureMapDistancesResponse(**map_parts.of_map_distances(found))

    async def FindMapPoints(self, request: pb.FindMapPointsRequest, context: Any) -> pb.FindMapPointsResponse:
        """The points of the surface around one."""
        found = await self._tiles.points(tenant_of(context), map_parts.points_around(request))
        return pb.FindMapPointsResponse(**map_parts.of_map_points(found))
