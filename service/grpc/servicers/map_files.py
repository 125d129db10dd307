"""MapFileService."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

from revisit.core.errors import BadField
from revisit.service.application import UseCases
from revisit.service.application.mapping.map_layout import PIECE_BYTES
from revisit.service.grpc.tenancy import tenant_of
from revisit.service.wire import map_parts, names, requests
from revisit.service.wire.answers import of_operation, of_page
from revisit.v1 import map_file_pb2 as pb
from revisit.v1 import map_file_pb2_grpc


class MapFileServicer(map_file_pb2_grpc.MapFileServiceServicer):
    """Publish, get, list, enable, delete and download map files."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._files = use_cases.map_files
        self._budget = use_cases.budget

    async def PublishMapFile(self, request: pb.PublishMapFileRequest, context: Any) -> pb.PublishMapFileResponse:
        """Queue the making of a file."""
        key = names.version_key(request.parent, "parent")
        posted = await self._files.publish(tenant_of(context), *key, request.map_descriptor)
        return pb.PublishMapFileResponse(operation=of_operation(posted.operation), replay=posted.replay)

    async def GetMapFile(self, request: pb.GetMapFileRequest, context: Any) -> pb.GetMapFileResponse:
        """Get the description of a file."""
        view = await self._files.get(tenant_of(context), *map_parts.file_key(request.name))
        return pb.GetMapFileResponse(map_file=map_parts.of_map_file(view))

    async def ListMapFiles(self, request: pb.ListMapFilesRequest, context: Any) -> pb.ListMapFilesResponse:
        """List the files of a map."""
        map_id, paging = names.map_id(request.parent, "parent"), requests.page(request)
        page = await self._files.list(tenant_of(context), map_id, paging)
        return pb.ListMapFilesResponse(**of_page("map_files", page, map_parts.of_map_file))

    async def EnableMapFile(self, request: pb.EnableMapFileRequest, context: Any) -> pb.EnableMapFileResponse:
        """Say that robots are to use a file."""
        view = await self._files.enable(tenant_of(context), *map_parts.file_key(request.name))
        return pb.EnableMapFileResponse(map_file=map_parts.of_map_file(view))

    async def DeleteMapFile(self, request: pb.DeleteMapFileRequest, context: Any) -> pb.DeleteMapFileResponse:
        """Delete a file."""
        await self._files.delete(tenant_of(context), *map_parts.file_key(request.name))
        return pb.DeleteMapFileResponse()

    async def DownloadMapFile(
        self, request: pb.DownloadMapFileRequest, context: Any
    ) -> AsyncIterator[pb.DownloadMapFileResponse]:
        """A file, or a part of it, in chunks."""
        file = await self._files.open(tenant_of(context), *map_parts.file_key(request.name))
        if request.offset > file.layout.size:
            raise BadField(f"the file has {file.layout.size} bytes", field="offset")
        end = request.offset + request.length if request.length else file.layout.size
        with self._budget.hold(tenant_of(context)) as held:
            await held.wait_for(PIECE_BYTES)
            yield pb.DownloadMapFileResponse(map_hash=file.view.sha256, size_bytes=file.layout.size)
            async for piece in file.pieces(request.offset, end):
                yield pb.DownloadMapFileResponse(data=piece)
