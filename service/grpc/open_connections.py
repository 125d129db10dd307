"""Open gRPC connections, counted by their source address until somebody is admitted over them.

gRPC's C core accepts connections and tells nobody of them before their first call. So they are looked up among the
open files of this process, and one too many is ended there; the core finds it closed. Where there is no /proc there is
no such bound.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import stat
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

from revisit.service.edge.connections import UnauthenticatedConnections

POLL_S = 1.0
"""How often the connections are looked up."""

FILES = Path("/proc/self/fd")


class Endpoint(NamedTuple):
    """The client's end of a connection."""

    address: str
    port: int


class OpenConnections:
    """The connections to a port, each counted as unauthenticated until somebody is admitted over it."""

    def __init__(self, unauthenticated: UnauthenticatedConnections | None = None) -> None:
        """They count in `unauthenticated`, which ends those beyond its bound."""
        self._unauthenticated = unauthenticated or UnauthenticatedConnections()
        self._admitted: set[Endpoint] = set()
        self._counted: dict[Endpoint, Callable[[], None]] = {}

    def admit(self, peer: str) -> None:
        """Somebody was admitted over the connection from `peer`, which is written as gRPC does."""
        end = endpoint_of(peer)
        self._admitted.add(end)
        self._settle(end)

    async def watch(self, port: int) -> None:
        """Look every now and then until cancelled."""
        while FILES.is_dir():
            await asyncio.sleep(POLL_S)
            before = set(self._admitted)
            present = await asyncio.to_thread(_connections, port)
            self._admitted -= before - present.keys()
            self._count(present)

    def _count(self, present: dict[Endpoint, int]) -> None:
        """Count those `present`, with their files, that are new; those that are gone no more."""
        for end in self._counted.keys() - present.keys():
            self._settle(end)
        for end, file in present.items():
            if end not in self._admitted and end not in self._counted:
                self._counted[end] = self._unauthenticated.arrive(end.address, partial(_end, file, end))

    def _settle(self, end: Endpoint) -> None:
        self._counted.pop(end, _nothing)()


def _nothing() -> None:
    """A connection that was not counted."""


def endpoint_of(peer: str) -> Endpoint:
    """Of gRPC's name of a peer: ipv4:1.2.3.4:5 or ipv6:%5B::1%5D:5; of another one its whole name."""
    address, _, port = unquote(peer).partition(":")[2].rpartition(":")
    if not port.isdecimal():
        return Endpoint(peer, 0)
    return Endpoint(address.removeprefix("[").removesuffix("]"), int(port))


def _connections(port: int) -> dict[Endpoint, int]:
    """The clients that are connected to `port` of this process, and the file of each."""
    found = {}
    for file in [int(path.name) for path in FILES.iterdir()]:
        connection = _opened(file)
        if connection is None:
            continue
        with connection:
            client = _client_of(connection, port)
        if client is not None:
            found[client] = file
    return found


def _opened(file: int) -> socket.socket | None:
    """The socket behind a file, None if it is none: as a file of our own, since that one may be closed meanwhile."""
    try:
        return socket.socket(fileno=os.dup(file)) if stat.S_ISSOCK(os.fstat(file).st_mode) else None
    except OSError:
        return None


def _client_of(connection: socket.socket, port: int) -> Endpoint | None:
    """The client of a connection to `port`; None of any other socket."""
    if connection.family not in (socket.AF_INET, socket.AF_INET6):
        return None
    try:
        if connection.getsockname()[1] != port:
            return None
        address, client_port = connection.getpeername()[:2]
    except OSError:
        return None
    return Endpoint(str(address).removeprefix("::ffff:"), int(client_port))


def _end(file: int, client: Endpoint) -> None:
    """End the connection behind a file, unless it is another one by now."""
    connection = _opened(file)
    if connection is None:
        return
    with connection, contextlib.suppress(OSError):
        if connection.getpeername()[1] == client.port:
            connection.shutdown(socket.SHUT_RDWR)
