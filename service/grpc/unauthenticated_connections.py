"""Unauthenticated gRPC connections, bounded by their source address.

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
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

from revisit.service.capacity.limits import UNAUTHENTICATED_PER_ADDRESS
from revisit.service.capacity.unauthenticated_limits import holder_of

POLL_S = 1.0
"""How often the connections are looked up."""

FILES = Path("/proc/self/fd")


class Endpoint(NamedTuple):
    """The client's end of a connection."""

    address: str
    port: int


class UnauthenticatedConnections:
    """Of each address so many connections may be open over which nobody was admitted; older ones go first."""

    def __init__(self, most: int = UNAUTHENTICATED_PER_ADDRESS) -> None:
        """`most` of each address."""
        self._most = most
        self._admitted: set[Endpoint] = set()
        self._unauthenticated: dict[Endpoint, None] = {}

    def admit(self, peer: str) -> None:
        """Somebody was admitted over the connection from `peer`, which is written as gRPC does."""
        self._admitted.add(endpoint_of(peer))

    async def watch(self, port: int) -> None:
        """Look every now and then until cancelled."""
        while FILES.is_dir():
            await asyncio.sleep(POLL_S)
            before = set(self._admitted)
            present = await asyncio.to_thread(_connections, port)
            self._admitted -= before - present.keys()
            self.end_those_beyond(present)

    def end_those_beyond(self, present: dict[Endpoint, int]) -> None:
        """End the unauthenticated connections beyond the limit among those `present`, with their files."""
        self._unauthenticated = {end: None for end in self._unauthenticated if end in present} | dict.fromkeys(present)
        by_holder: dict[str, list[Endpoint]] = defaultdict(list)
        for end in self._unauthenticated:
            if end not in self._admitted:
                by_holder[holder_of(end.address)].append(end)
        for ends in by_holder.values():
            for end in ends[: max(0, len(ends) - self._most)]:
                _end(present[end], end)


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
