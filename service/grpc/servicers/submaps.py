"""SubmapService."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

from revisit.service.application import UseCases
from revisit.service.grpc.tenancy import tenant_of
from revisit.service.wire import answers, names, requests
from revisit.service.wire.rendering import page_message
from revisit.v1 import submap_pb2 as pb
from revisit.v1 import submap_pb2_grpc


class SubmapServicer(submap_pb2_grpc.SubmapServiceServicer):
    """Post, get, list, delete and download submaps."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._submaps = use_cases.submaps
        self._posting = use_cases.posting
        self._budget = use_cases.budget

    async def PostSubmap(self, request: pb.PostSubmapRequest, context: Any) -> pb.PostSubmapResponse:
        """Store a submap and queue its description."""
        posted = await self._posting.post(tenant_of(context), requests.post_submap(request))
        return pb.PostSubmapResponse(**answers.of_posted(posted))

    async def GetSubmap(self, request: pb.GetSubmapRequest, context: Any) -> pb.GetSubmapResponse:
        """Get a submap."""
        full = request.view == pb.GetSubmapRequest.FULL
        view = await self._submaps.get(tenant_of(context), names.submap_key(request.name), full=full)
        return pb.GetSubmapResponse(submap=answers.of_submap(view))

    async def ListSubmaps(self, request: pb.ListSubmapsRequest, context: Any) -> pb.ListSubmapsResponse:
        """List the submaps of a session."""
        session = names.session_key(request.parent, "parent")
        page = await self._submaps.list(tenant_of(context), session, requests.page(request))
        return await page_message(pb.ListSubmapsResponse, "submaps", page, answers.of_submap)

    async def DeleteSubmap(self, request: pb.DeleteSubmapRequest, context: Any) -> pb.DeleteSubmapResponse:
        """Delete a submap."""
        await self._submaps.delete(tenant_of(context), names.submap_key(request.name))
        return pb.DeleteSubmapResponse()

    async def DownloadSubmap(
        self, request: pb.DownloadSubmapRequest, context: Any
    ) -> AsyncIterator[pb.DownloadSubmapResponse]:
        """A file in chunks; the first one says what it is."""
        key, what = names.submap_key(request.name), requests.download(request)
        with self._budget.hold(tenant_of(context)) as held:
            file = await self._submaps.download(tenant_of(context), key, *what, room=held.wait_for)
            held.set(len(file.data))
            yield pb.DownloadSubmapResponse(media_type=file.media_type, filename=file.filename)
            for piece in file.pieces():
                yield pb.DownloadSubmapResponse(data=piece)
