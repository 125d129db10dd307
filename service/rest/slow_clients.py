"""Slow clients: a connection that does not bring its request head in time is closed (bodies: see `BodyLimit`)."""

from __future__ import annotations

import asyncio
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

HEAD_S = 10.0
"""Time for a request line with its headers, counted from the connection or from the first byte of the next request."""

REST_S = 2.0
"""Time for the rest of a body whose request was answered already: refused, or given up."""

HEAD_BYTES = 32 * 2**10
"""Bytes of a request line with its headers."""

CONNECTIONS = 512
"""Open connections. One more takes the place of the one that has been awaited the longest; where all are being
answered it is let in, and from twice as many on it is told 503 at once."""

KEEP_ALIVE_S = 15
"""How long a connection without a request stays open."""


class DeadlineProtocol(H11Protocol):
    """uvicorn's HTTP/1.1 with a deadline where uvicorn would wait for ever: see `_idle`.

    uvicorn alone refuses everyone once there are too many connections, also where these only keep silent.
    """

    head_s = HEAD_S
    rest_s = REST_S
    most_connections = CONNECTIONS
    _deadline: asyncio.TimerHandle | None = None
    _heard_s = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Start the clock of the first request."""
        super().connection_made(transport)
        self._heard_s = asyncio.get_running_loop().time()
        if len(self.connections) > self.most_connections:
            self._make_room()
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Feed the parser; stop the clock once the head is there."""
        was_idle = self._idle()
        super().data_received(data)
        if was_idle and not self._idle():
            self._heard_s = asyncio.get_running_loop().time()
        self._watch()

    def on_response_complete(self) -> None:
        """Start the clock of what is left of the body, or of the next request."""
        super().on_response_complete()
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the clock."""
        self._stop()
        super().connection_lost(exc)

    def _make_room(self) -> None:
        """Close the connection whose last request head is the longest ago and which owes us bytes: idle ones first."""
        others = (other for other in self.connections if isinstance(other, DeadlineProtocol) and other is not self)
        awaited = [other for other in others if other._awaited() and not other.transport.is_closing()]
        if awaited:
            min(awaited, key=lambda other: (not other._idle(), other._heard_s)).transport.close()

    def _awaited(self) -> bool:
        """Whether it is the client's turn: to send a request, or the rest of one."""
        return self.conn.their_state in (h11.IDLE, h11.SEND_BODY)

    def _watch(self) -> None:
        awaits_head = self.conn.their_state is h11.IDLE
        if not self._idle():
            self._stop()
        # uvicorn's own clock, which runs after every answer, is for the next head only.
        elif self._deadline is None and not (awaits_head and self.timeout_keep_alive_task is not None):
            patience_s = self.head_s if awaits_head else self.rest_s
            self._deadline = asyncio.get_running_loop().call_later(patience_s, self._expire)

    def _idle(self) -> bool:
        """Whether nothing but a request head, or the rest of a body that was answered already, is awaited."""
        state = self.conn.their_state
        return state is h11.IDLE or (state is h11.SEND_BODY and self.cycle.response_complete)

    def _expire(self) -> None:
        self._deadline = None
        if self._idle():
            self.transport.close()

    def _stop(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


def uvicorn_limits() -> dict[str, Any]:
    """The arguments of `uvicorn.Config` that bound what clients can hold open."""
    return {
        "http": DeadlineProtocol,
        "ws": "none",
        "h11_max_incomplete_event_size": HEAD_BYTES,
        # Room is made above the limit, and what gives way is still counted for a moment; so uvicorn refuses only where
        # far more are there because none could be given up.
        "limit_concurrency": 2 * CONNECTIONS,
        "timeout_keep_alive": KEEP_ALIVE_S,
        "server_header": False,
        # Who asks is known by the connection, not by what a client writes into X-Forwarded-For.
        "proxy_headers": False,
    }
