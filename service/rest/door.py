"""The door: the first bytes of a connection, read before HTTP is parsed, where too many of its address begin.

A connection that asks for one thing costs the event loop more than a millisecond, one that is sent away here a small
part of that. Connections with a known credential go on, and /livez is answered.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import socket
from collections.abc import Callable
from dataclasses import dataclass, field

from revisit.service.domain.errors import RateLimited
from revisit.service.edge.connections import Shown, UnauthenticatedConnections
from revisit.service.rest.errors import problem

SHOWN_BYTES = 4096
"""Of a request head, in which a credential is looked for."""

PATIENCE_S = 2.0
"""For so long a connection may wait here."""

MOST_WAITING = 256
"""Connections that wait; one more takes the place of the oldest."""

_BEARER = re.compile(rb"\r\nauthorization:[ \t]*bearer[ \t]+([^\r\n]{1,2000}?)[ \t]*\r\n", re.IGNORECASE)

AGAIN_S = 0.05
"""How often an encrypted connection that waits is tried again."""


def answer(status: str, media_type: str, body: bytes, more: str = "") -> bytes:
    """A whole answer, after which the connection is closed."""
    head = f"HTTP/1.1 {status}\r\ncontent-type: {media_type}\r\ncontent-length: {len(body)}\r\n{more}"
    return head.encode() + b"connection: close\r\n\r\n" + body


TOO_MANY = RateLimited("too many connections of this address begin without a credential; keep one open")
REFUSAL = answer(
    "429 Too Many Requests", "application/problem+json", bytes(problem(TOO_MANY, "none").body), "retry-after: 1\r\n"
)
ALIVE = answer("200 OK", "application/json", b'{"status":"ok"}')


@dataclass
class Arrival:
    """A connection that was accepted, where it comes from, and how it was counted."""

    connection: socket.socket
    address: str
    shown: Shown | None = Shown.NOTHING
    """None where it did not count."""


@dataclass
class _Waiting:
    """A connection that waits, and until when at most."""

    arrival: Arrival
    until_s: float
    timer: asyncio.TimerHandle | None = None


@dataclass
class Door:
    """Lets connections in, or sends them away. All calls come from the event loop."""

    unauthenticated: UnauthenticatedConnections
    let_in: Callable[[Arrival], None]
    encrypted: bool = False
    """Nothing can be seen of a connection before its handshake: one too many waits for its turn."""
    _waiting: dict[socket.socket, _Waiting] = field(default_factory=dict)

    def arrive(self, arrival: Arrival) -> None:
        """Let a connection in if it may begin, or by its first bytes."""
        if self.encrypted:
            arrival.shown = Shown.UNKNOWN
        if self._begins(arrival):
            self.let_in(arrival)
        elif self.encrypted:
            self._wait(arrival)
        else:
            self._look(arrival)

    def _begins(self, arrival: Arrival) -> bool:
        return arrival.shown is not None and self.unauthenticated.may_begin(arrival.address, arrival.shown)

    def close(self) -> None:
        """Send all away that wait."""
        for connection in tuple(self._waiting):
            self._forget(connection)
            connection.close()

    def _look(self, arrival: Arrival) -> None:
        try:
            shown = arrival.connection.recv(SHOWN_BYTES, socket.MSG_PEEK)
        except BlockingIOError:
            self._wait(arrival)
            return
        except OSError:
            shown = b""
        if shown and self._goes_on(arrival, shown):
            self.let_in(arrival)
            return
        _send_away(arrival.connection, ALIVE if shown.startswith(b"GET /livez ") else REFUSAL)

    def _goes_on(self, arrival: Arrival, shown: bytes) -> bool:
        """Whether a connection is let in for its credential."""
        bearer = _BEARER.search(shown)
        if bearer is None:
            arrival.shown = Shown.READINESS
            return shown.startswith(b"GET /readyz ") and self._begins(arrival)
        credential = bearer[1].decode("latin-1")
        if self.unauthenticated.is_known(credential):
            arrival.shown = None
            return self.unauthenticated.may_return(credential)
        arrival.shown = Shown.UNKNOWN
        return self._begins(arrival)

    def _wait(self, arrival: Arrival) -> None:
        """Look again once there is something to see, or, where nothing is, once there is time."""
        connection, loop = arrival.connection, asyncio.get_running_loop()
        if len(self._waiting) >= MOST_WAITING:
            oldest = next(iter(self._waiting))
            self._forget(oldest)
            oldest.close()
        waiting = self._waiting[connection] = _Waiting(arrival, loop.time() + PATIENCE_S)
        if self.encrypted:
            waiting.timer = loop.call_later(AGAIN_S, self._try_again, connection)
        else:
            waiting.timer = loop.call_later(PATIENCE_S, self._expire, connection)
            loop.add_reader(connection, self._seen, connection)

    def _seen(self, connection: socket.socket) -> None:
        self._look(self._forget(connection).arrival)

    def _try_again(self, connection: socket.socket) -> None:
        waiting, loop = self._waiting[connection], asyncio.get_running_loop()
        if self._begins(waiting.arrival):
            self.let_in(self._forget(connection).arrival)
        elif loop.time() > waiting.until_s:
            self._expire(connection)
        else:
            waiting.timer = loop.call_later(AGAIN_S, self._try_again, connection)

    def _expire(self, connection: socket.socket) -> None:
        self._forget(connection)
        connection.close()

    def _forget(self, connection: socket.socket) -> _Waiting:
        waiting = self._waiting.pop(connection)
        if waiting.timer is not None:
            waiting.timer.cancel()
        if not self.encrypted:
            asyncio.get_running_loop().remove_reader(connection)
        return waiting


VOUCH = "vouch"
"""Under this name the state of a request holds the `Voucher` of its connection, where a door has let it in."""


@dataclass
class Voucher:
    """Tells, once, that somebody was admitted over a connection."""

    unauthenticated: UnauthenticatedConnections
    address: str
    shown: Shown | None
    vouched: bool = False

    def admitted(self, credential: str | None) -> None:
        """A caller was admitted with this credential, or with none where anyone is."""
        if not self.vouched:
            self.vouched = True
            self.unauthenticated.vouch(self.address, credential, self.shown)


def _send_away(connection: socket.socket, answer: bytes) -> None:
    """Tell a client why, and close its connection."""
    with connection, contextlib.suppress(OSError):
        # Unread bytes would make the kernel take back the answer.
        connection.recv(SHOWN_BYTES)
        connection.send(answer)
