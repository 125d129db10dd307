"""The HTTP server on a socket that is bound already: it sees the address of a connection before its TLS handshake."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import uvicorn

from revisit.service.edge.connections import UnauthenticatedConnections
from revisit.service.rest.door import VOUCH, Arrival, Door, Voucher
from revisit.service.rest.slow_clients import DeadlineProtocol

HANDSHAKE_S = 10.0
"""Time for a TLS handshake over HTTP; gRPC has the same in its options."""

BACKLOG = 4096
"""Connections that the kernel holds until they are accepted. To send so many away takes 0.3 s; a client that finds no
room there tries again after a second. The port is not shared (SO_REUSEPORT): another process could take connections
from it."""

NO_FILES_S = 0.2
"""How long nothing is accepted where the process may open no more files."""

AT_ONCE = 32
"""Connections that are accepted in one turn of the event loop, so that a flood leaves room for others between two
turns; to send one away takes 0.07 ms of a core. It takes some turns until the first bytes of those let in are read;
before that they are unauthenticated, and an address may have more of those than these turns bring.
"""

_EXHAUSTED = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})


class ListeningServer(uvicorn.Server):
    """uvicorn without signal handlers of its own, on a socket that was bound before.

    So a taken port ends the start, port 0 is known, and one handler of signals stops all servers.
    """

    def __init__(
        self, config: uvicorn.Config, listener: socket.socket, unauthenticated: UnauthenticatedConnections | None = None
    ) -> None:
        super().__init__(config)
        self._listener = listener
        self._unauthenticated = unauthenticated or UnauthenticatedConnections()
        self._door = Door(self._unauthenticated, self._arrived)
        self._welcomes: set[asyncio.Task[None]] = set()

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave the signals alone."""
        yield

    async def serve(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve on the bound socket."""
        await super().serve(sockets=[self._listener])

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen on the bound socket. uvicorn would leave the accepting to asyncio, which tells no address in time."""
        await self.lifespan.startup()
        self._listener.setblocking(False)
        self._listener.listen(BACKLOG)
        self._door.encrypted = self.config.ssl is not None
        accepting = _Accepting(self._listener, self._door)
        accepting.begin()
        self.servers, self.started = [accepting], True  # type: ignore[list-item]  # uvicorn calls its methods

    def _arrived(self, arrival: Arrival) -> None:
        welcome = asyncio.get_running_loop().create_task(self._welcome(arrival))
        self._welcomes.add(welcome)
        welcome.add_done_callback(self._welcomes.discard)

    async def _welcome(self, arrival: Arrival) -> None:
        """Shake hands, where there is TLS, and leave the connection to its protocol."""
        connection = arrival.connection
        settle = self._unauthenticated.arrive(arrival.address, lambda: _end(connection))
        tls = self.config.ssl
        handshake_s = None if tls is None else HANDSHAKE_S
        try:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            await asyncio.get_running_loop().connect_accepted_socket(
                lambda: self._protocol(settle, arrival), connection, ssl=tls, ssl_handshake_timeout=handshake_s
            )
        except (OSError, TimeoutError):
            settle()
            connection.close()

    def _protocol(self, settle: Callable[[], None], arrival: Arrival) -> DeadlineProtocol:
        make: Any = self.config.http_protocol_class
        vouch = Voucher(self._unauthenticated, arrival.address, arrival.shown)
        protocol: DeadlineProtocol = make(self.config, self.server_state, {**self.lifespan.state, VOUCH: vouch})
        protocol.settle = settle
        return protocol


class _Accepting:
    """Accepts connections on the running loop; uvicorn closes it as it would the servers of asyncio."""

    def __init__(self, listener: socket.socket, door: Door) -> None:
        """`door` takes each connection, with the address it comes from."""
        self._listener, self._door = listener, door
        self._closed = False

    def begin(self) -> None:
        """Accept from now on, unless it was closed meanwhile."""
        if not self._closed:
            asyncio.get_running_loop().add_reader(self._listener, self._accept)

    def close(self) -> None:
        """Accept no more."""
        self._closed = True
        asyncio.get_running_loop().remove_reader(self._listener)
        self._door.close()

    async def wait_closed(self) -> None:
        """Nothing is accepted any more."""

    def _accept(self) -> None:
        # More than one: in each turn of the loop one alone would let a flood keep others waiting for seconds.
        for _ in range(AT_ONCE):
            try:
                connection, address = self._listener.accept()
            except (BlockingIOError, InterruptedError):
                return
            except OSError as error:
                if error.errno in _EXHAUSTED:
                    loop = asyncio.get_running_loop()
                    loop.remove_reader(self._listener)
                    loop.call_later(NO_FILES_S, self.begin)
                    return
                continue
            connection.setblocking(False)
            self._door.arrive(Arrival(connection, str(address[0])))


def _end(connection: socket.socket) -> None:
    """Its transport, which may be shaking hands, finds it closed."""
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
