"""Slow clients: a connection that brings no request head, or takes no answer, in time is closed.

For bodies see `BodyLimit`, for the answer where all slots are taken `RequestSlots`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from revisit.service.rest.limits import HttpLimits

HEAD_S = 10.0
"""Time for a request line with its headers, counted from the connection or from the first byte of the next request."""

REST_S = 2.0
"""Time for the rest of a body after its request was answered: refused, or given up."""

HEAD_BYTES = 32 * 2**10
"""Bytes of a request line with its headers."""

CONNECTIONS = 512
"""Open connections. One more takes the place of the one that has been awaited the longest; where all are being
answered it is let in, up to as many as are answered at the same time and `RESERVED`."""

RESERVED = 64
"""Connections beyond those, on which only health is told: see `RequestSlots`."""

WRITE_S = 10.0
"""A client takes all of its answer that waits in our memory in so long, or `WRITE_BYTES` of it, or is cut off."""

WRITE_BYTES = 32 * 2**10

STALLED_S = 1.0
"""An answer of which nothing was taken for so long gives its place to a new connection, where none is free."""

PIPELINED = 4
"""Requests in a row that may come before the answer to the one before them; then the connection is closed. Browsers and
the usual libraries send none so."""

_WITHOUT_BODY, _END_OF_HEAD = (b"GET ", b"HEAD"), b"\r\n\r\n"

KEEP_ALIVE_S = 15
"""How long a connection without a request stays open."""


class DeadlineProtocol(H11Protocol):
    """uvicorn's HTTP/1.1 with a deadline where uvicorn would wait for ever: see `_idle`.

    uvicorn alone refuses everyone once there are too many connections, also where these only keep silent.
    """

    head_s = HEAD_S
    rest_s = REST_S
    write_s = WRITE_S
    most_connections = CONNECTIONS
    most_pipelined = PIPELINED
    settle: Callable[[], None] | None = None
    """To be called once the first request head is there, or the connection is gone (`edge.connections`)."""

    _deadline: asyncio.TimerHandle | None = None
    _write_check: asyncio.TimerHandle | None = None
    _heard_s = 0.0
    _taken_s = 0.0
    _drained = False
    _unread_bytes = 0
    _pipelined = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Start the clock of the first request."""
        super().connection_made(transport)
        self._heard_s = asyncio.get_running_loop().time()
        crowded = len(self.connections) > self.most_connections and not self._make_room()
        if crowded and len(self.connections) > self.most_connections + HttpLimits.requests + RESERVED:
            transport.abort()
            return
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Feed the parser; stop the clock once the head is there."""
        was_idle = self._idle()
        if was_idle and data[:4] in _WITHOUT_BODY and data.count(_END_OF_HEAD) > self.most_pipelined:
            # To answer the first few would take most of the time that such a client is after.
            self.transport.abort()
            return
        super().data_received(data)
        if was_idle and not self._idle():
            self._heard_s = asyncio.get_running_loop().time()
            self._settle()
        self._watch()

    def on_response_complete(self) -> None:
        """Start the clock of the rest of the body, or of the next request."""
        self._watch_writing()
        self._pipelined = self._pipelined + 1 if self.conn.trailing_data[0] else 0
        if self._pipelined > self.most_pipelined:
            self.transport.close()
        super().on_response_complete()
        self._watch()

    def pause_writing(self) -> None:
        """The client takes its answer more slowly than it is made: start the clock of that."""
        super().pause_writing()
        if self._write_check is not None:
            self._write_check.cancel()
            self._write_check = None
        self._watch_writing()

    def resume_writing(self) -> None:
        """The client has taken all bytes."""
        self._drained = True
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the clocks."""
        self._settle()
        self._stop()
        if self._write_check is not None:
            self._write_check.cancel()
        super().connection_lost(exc)

    def _settle(self) -> None:
        if self.settle is not None:
            self.settle()
            self.settle = None

    def _watch_writing(self) -> None:
        """Check now and then that the bytes waiting for the client become fewer, until none is left."""
        if self._write_check is None and self.transport.get_write_buffer_size() > 0:
            loop = asyncio.get_running_loop()
            self._taken_s = loop.time()
            self._look_again()

    def _look_again(self) -> None:
        self._drained, self._unread_bytes = False, self.transport.get_write_buffer_size()
        self._write_check = asyncio.get_running_loop().call_later(self.write_s, self._check_writing)

    def _check_writing(self) -> None:
        self._write_check = None
        left = self.transport.get_write_buffer_size()
        if left == 0:
            return
        # Without a pause an answer may have been added meanwhile: there only a buffer that stands still is a sign.
        taken = WRITE_BYTES if self.flow.write_paused else 1
        if self._drained or left <= self._unread_bytes - taken or (taken == 1 and left > self._unread_bytes):
            self._taken_s = asyncio.get_running_loop().time()
            self._look_again()
        else:
            self.transport.abort()

    def _stalled(self) -> bool:
        """Whether an answer waits for the client, of which nothing was taken lately."""
        if self._write_check is None or self._drained:
            return False
        unread = self.transport.get_write_buffer_size()
        return unread >= self._unread_bytes > 0 and asyncio.get_running_loop().time() > self._taken_s + STALLED_S

    def _make_room(self) -> bool:
        """Close the connection with the oldest request head that owes us bytes: idle ones first.

        One that does not take its answer is as good. Whether there was one.
        """
        others = (other for other in self.connections if isinstance(other, DeadlineProtocol) and other is not self)
        awaited = [other for other in others if other._gives_way() and not other.transport.is_closing()]
        if not awaited:
            return False
        chosen = min(awaited, key=lambda other: (not other._idle(), other._heard_s))
        if chosen.transport.get_write_buffer_size() > 0:
            chosen.transport.abort()
        else:
            chosen.transport.close()
        return True

    def _gives_way(self) -> bool:
        return self._stalled() or (self._awaited() and self.transport.get_write_buffer_size() == 0)

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
    """The arguments of `uvicorn.Config` that bound clients' open connections."""
    return {
        "http": DeadlineProtocol,
        "ws": "none",
        "h11_max_incomplete_event_size": HEAD_BYTES,
        "timeout_keep_alive": KEEP_ALIVE_S,
        "server_header": False,
        # The client's address is that of the connection, not a value of X-Forwarded-For.
        "proxy_headers": False,
    }
