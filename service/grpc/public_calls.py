"""Calls that need no credential: health and reflection. They have slots of their own, by address and connection."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

from revisit.service.capacity.addresses import holder_of
from revisit.service.capacity.limits import PUBLIC_CALLS_WAITING, PUBLIC_WATCHES
from revisit.service.capacity.slots import Slots
from revisit.service.domain.errors import DeadlineExceeded
from revisit.service.edge.connections import UnauthenticatedConnections
from revisit.service.grpc.open_connections import endpoint_of


class PublicCalls:
    """The slots of public calls of one server."""

    def __init__(self) -> None:
        self._watches = Slots(PUBLIC_WATCHES)
        self._waiting = UnauthenticatedConnections(PUBLIC_CALLS_WAITING)

    @contextmanager
    def watch(self, peer: str) -> Iterator[None]:
        """The slot of a public stream. Raises RateLimited."""
        address = holder_of(endpoint_of(peer).address)
        self._watches.take(address, peer)
        try:
            yield
        finally:
            self._watches.give(address, peer)

    @asynccontextmanager
    async def message(self, peer: str) -> AsyncIterator[None]:
        """Within the block the message of a public call is read. Raises DeadlineExceeded where newer calls wait."""
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(None) as reading:
                settle = self._waiting.arrive(endpoint_of(peer).address, lambda: reading.reschedule(loop.time()))
                try:
                    yield
                finally:
                    settle()
        except TimeoutError as error:
            raise DeadlineExceeded("the message did not come while newer calls waited: repeat the call") from error
