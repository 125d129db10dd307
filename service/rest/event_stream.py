"""Server-sent events: an answer that goes on for as long as its client reads it and may.

https://html.spec.whatwg.org/multipage/server-sent-events.html
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any

from fastapi import Response
from pydantic_core import to_json
from starlette.types import Message, Receive, Scope, Send

from revisit.core.errors import RevisitError
from revisit.service.calls.push import event_fields
from revisit.service.capacity.call_slots import watching
from revisit.service.features.events.calls import EventView
from revisit.service.rest.errors import problem
from revisit.service.wire.json_form import json_form
from revisit.v1 import event_pb2

MEDIA_TYPE = "text/event-stream"

RECONNECT_MS = 2000
"""How long a browser waits before it connects again."""

HEADERS = [
    (b"content-type", f"{MEDIA_TYPE}; charset=utf-8".encode()),
    # Proxies that collect answers before they pass them on must not.
    (b"x-accel-buffering", b"no"),
]


class EventStream(Response):
    """Sends events until the client goes, loses its right, or the service stops.

    A client that does not read is cut off by `DeadlineProtocol`; the service holds one batch of events for it.
    """

    media_type = MEDIA_TYPE

    def __init__(
        self,
        events: AsyncIterator[EventView | None],
        refused: Callable[[], Coroutine[Any, Any, RevisitError]],
    ) -> None:
        """`refused` returns once the client has lost its right to read, with the reason."""
        super().__init__()
        self._events = events
        self._refused = refused

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the events. Raises RateLimited, and the error of the first of them."""
        with watching():
            first = await anext(self._events)
            await send({"type": "http.response.start", "status": 200, "headers": HEADERS})
            await send(_piece(f"retry: {RECONNECT_MS}\n\n{text_of(first)}"))
            sending = asyncio.create_task(self._send(send))
            left, refused = asyncio.create_task(gone(receive)), asyncio.create_task(self._refused())
            try:
                await asyncio.wait((sending, left, refused), return_when=asyncio.FIRST_COMPLETED)
            finally:
                for task in (sending, left, refused):
                    task.cancel()
            ends = await asyncio.gather(sending, refused, left, return_exceptions=True)
            error = next((end for end in ends if isinstance(end, RevisitError)), None)
            if error is not None:
                await send(_piece(_problem_text(error, scope["state"]["request_id"])))
            await send({"type": "http.response.body", "body": b"", "more_body": False})
            defect = next((end for end in ends if isinstance(end, Exception) and end is not error), None)
            if defect is not None:
                raise defect

    async def _send(self, send: Send) -> None:
        async for event in self._events:
            await send(_piece(text_of(event)))


def text_of(event: EventView | None) -> str:
    """An event as it is sent; None is a comment, which clients ignore."""
    if event is None:
        return ": alive\n\n"
    data = to_json(json_form(event_pb2.Event, event_fields(event)), inf_nan_mode="null").decode()
    return f"id: {event.number}\nevent: {event.kind.value.lower()}\ndata: {data}\n\n"


def _problem_text(error: RevisitError, request_id: str) -> str:
    return f"event: problem\ndata: {bytes(problem(error, request_id).body).decode()}\n\n"


def _piece(text: str) -> Message:
    return {"type": "http.response.body", "body": text.encode(), "more_body": True}


async def gone(receive: Receive) -> None:
    """Return once the client has left."""
    while (await receive())["type"] != "http.disconnect":
        pass
