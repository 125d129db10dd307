"""SubmapService."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

from revisit.core.errors import BadField
from revisit.service.application import SubmapKey, UseCases
from revisit.service.application.catalogue.submaps import DownloadKind, PostSubmap
from revisit.service.grpc import messages, names
from revisit.service.grpc.tenancy import tenant_of
from revisit.v1 import submap_pb2, submap_pb2_grpc

CHUNK_BYTES = 2**20

_DOWNLOADS: dict[int, tuple[DownloadKind, str | None]] = {
    submap_pb2.DOWNLOAD_FORMAT_PCD: (DownloadKind.POINTS, "pcd"),
    submap_pb2.DOWNLOAD_FORMAT_PLY: (DownloadKind.POINTS, "ply"),
    submap_pb2.DOWNLOAD_FORMAT_NPY: (DownloadKind.POINTS, "npy"),
    submap_pb2.DOWNLOAD_FORMAT_MESH: (DownloadKind.MESH, None),
    submap_pb2.DOWNLOAD_FORMAT_NEURAL: (DownloadKind.NEURAL, None),
    submap_pb2.DOWNLOAD_FORMAT_DESCRIPTOR: (DownloadKind.DESCRIPTOR, None),
}


class SubmapServicer(submap_pb2_grpc.SubmapServiceServicer):
    """Post, get, list, delete and download submaps."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._submaps = use_cases.submaps

    async def PostSubmap(self, request: submap_pb2.PostSubmapRequest, context: Any) -> submap_pb2.PostSubmapResponse:
        """Store a submap and queue its description."""
        session = names.session_key(request.parent, "parent")
        key = SubmapKey(session.map_id, session.session_id, request.submap_id)
        pose = messages.matrix(request.t_odom_submap, request.HasField("t_odom_submap"), "T_odom_submap")
        command = PostSubmap(key, pose, request.stamp_ns, messages.cloud(request.cloud))
        return messages.posted_message(await self._submaps.post(tenant_of(context), command))

    async def GetSubmap(self, request: submap_pb2.GetSubmapRequest, context: Any) -> submap_pb2.GetSubmapResponse:
        """Get a submap."""
        full = request.view == submap_pb2.SUBMAP_VIEW_FULL
        view = await self._submaps.get(tenant_of(context), names.submap_key(request.name), full=full)
        return submap_pb2.GetSubmapResponse(submap=messages.submap_message(view))

    async def ListSubmaps(self, request: submap_pb2.ListSubmapsRequest, context: Any) -> submap_pb2.ListSubmapsResponse:
        """List the submaps of a session."""
        session = names.session_key(request.parent, "parent")
        page = await self._submaps.list(tenant_of(context), session, messages.page_request(request))
        items = [messages.submap_message(view) for view in page.items]
        return submap_pb2.ListSubmapsResponse(submaps=items, next_page_token=page.next_token)

    async def DeleteSubmap(
        self, request: submap_pb2.DeleteSubmapRequest, context: Any
    ) -> submap_pb2.DeleteSubmapResponse:
        """Delete a submap."""
        await self._submaps.delete(tenant_of(context), names.submap_key(request.name))
        return submap_pb2.DeleteSubmapResponse()

    async def DownloadSubmap(
        self, request: submap_pb2.DownloadSubmapRequest, context: Any
    ) -> AsyncIterator[submap_pb2.DownloadSubmapResponse]:
        """A file in chunks; the first one says what it is."""
        if request.format not in _DOWNLOADS:
            raise BadField("unknown download format", field="format")
        key = names.submap_key(request.name)
        file = await self._submaps.download(tenant_of(context), key, *_DOWNLOADS[request.format])
        yield submap_pb2.DownloadSubmapResponse(
            media_type=file.media_type, filename=file.filename, data=file.data[:CHUNK_BYTES]
        )
        for start in range(CHUNK_BYTES, len(file.data), CHUNK_BYTES):
            yield submap_pb2.DownloadSubmapResponse(data=file.data[start : start + CHUNK_BYTES])
