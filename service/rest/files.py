"""Files as answers: made when the budget has room for them, and sent in pieces."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping

from fastapi import Response
from starlette.types import Receive, Scope, Send

from revisit.service.capacity.byte_budget import ByteBudget
from revisit.service.domain.identity import TenantId
from revisit.service.features.catalogue.downloads import Download, Room


class FileInPieces(Response):
    """A download that counts in the budget until its last piece is handed over, or its connection is lost."""

    def __init__(
        self,
        budget: ByteBudget,
        tenant: TenantId,
        make: Callable[[Room], Awaitable[Download]],
        headers: Mapping[str, str] | None = None,
    ) -> None:
        """`make` makes the file when the budget has room; its error is the answer. `headers` are beside its own."""
        super().__init__()
        self._extra = headers or {}
        self._budget = budget
        self._tenant = tenant
        self._make = make

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Make the file and send it. Raises WorkersBusy where the budget has no room, and the errors of `make`."""
        with self._budget.hold(self._tenant) as held:
            file = await self._make(held.wait_for)
            held.set(len(file.data))
            await send({"type": "http.response.start", "status": 200, "headers": _headers(file, self._extra)})
            await send_body(send, _in_turn(file.pieces()))


async def send_body(send: Send, pieces: AsyncIterator[bytes]) -> None:
    """Send the body of an answer; its last piece says that it is the last.

    An end of its own would follow bytes that the client has already, and its next request would come before that end:
    a client in a hurry would look like one that pipelines requests.
    """
    waiting = b""
    async for piece in pieces:
        if waiting:
            await send({"type": "http.response.body", "body": waiting, "more_body": True})
        waiting = piece
    await send({"type": "http.response.body", "body": waiting, "more_body": False})


async def _in_turn(pieces: Iterator[bytes]) -> AsyncIterator[bytes]:
    for piece in pieces:
        yield piece


def _headers(file: Download, others: Mapping[str, str]) -> list[tuple[bytes, bytes]]:
    headers = {
        **others,
        "content-type": file.media_type,
        "content-length": str(len(file.data)),
        "content-disposition": f'attachment; filename="{file.filename}"',
    }
    return [(name.encode(), value.encode("latin-1")) for name, value in headers.items()]
