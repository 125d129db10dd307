"""A bad link: a TCP proxy that delays, throttles, cuts at a byte, goes silent or dark, or leaves one end open."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from tests.support.patience import PATIENCE_S

CHUNK_BYTES = 65_536
DARK_POLL_S = 0.01
RESET = struct.pack("ii", 1, 0)
"""Lingering for no time: closing sends RST, as a link that breaks does sooner or later."""


@dataclass(frozen=True)
class Fault:
    """What happens to one connection. Bytes are counted in both directions together; None: never.

    `half_open`: the cut is seen by the client only, the service still waits. `silent_after`: nothing passes any more,
    and neither end is told.
    """

    cut_after: int | None = None
    silent_after: int | None = None
    half_open: bool = False
    delay_s: float = 0.0
    bytes_per_s: float | None = None


WHOLE = Fault()


class BadLink:
    """Where clients connect to; `target` (host:port), `fault` and `dark` may change while it runs.

    While it is `dark` nothing passes in either direction, no connection comes about and nobody is told. What was sent
    meanwhile arrives once it has healed, as TCP would send it again.
    """

    def __init__(self, target: str, fault: Callable[[], Fault]) -> None:
        """`fault` is asked once for each connection."""
        self.target = target
        self.fault = fault
        self.dark = False
        self.port = 0
        self.cuts = 0
        self.connections = 0
        self._forgotten = 0
        self._under_way: set[asyncio.Task[None]] = set()

    @property
    def address(self) -> str:
        """host:port."""
        return f"127.0.0.1:{self.port}"

    def heal(self, *, forgotten: bool) -> None:
        """End the darkness; the connections of before are `forgotten`, as by a router: reset with their next byte."""
        self._forgotten = self.connections if forgotten else 0
        self.dark = False

    async def passes(self, number: int = sys.maxsize) -> bool:
        """Once it is not dark: whether connection `number` is still there."""
        while self.dark:
            await asyncio.sleep(DARK_POLL_S)
        return number > self._forgotten

    def accept(self, client: asyncio.StreamReader, to_client: asyncio.StreamWriter) -> None:
        """Serve a connection. The loop itself would forget a task whose client has gone and whose service has not."""
        task = asyncio.get_running_loop().create_task(self.connect(client, to_client))
        self._under_way.add(task)
        task.add_done_callback(self._under_way.discard)

    async def connect(self, client: asyncio.StreamReader, to_client: asyncio.StreamWriter) -> None:
        """Serve one connection until both ends are done or the fault strikes."""
        await self.passes()
        self.connections += 1
        connection = _Connection(self, self.connections)
        host, _, port = self.target.rpartition(":")
        try:
            service, to_service = await asyncio.open_connection(host, int(port))
        except OSError:
            _reset(to_client)
            return
        upwards = asyncio.create_task(connection.pump(client, to_service))
        downwards = asyncio.create_task(connection.pump(service, to_client))
        try:
            await asyncio.wait((upwards, downwards))
            if connection.cut:
                self.cuts += 1
                _reset(to_client)
                if connection.fault.half_open:
                    await asyncio.wait_for(service.read(), PATIENCE_S)
        finally:
            for end in (to_client, to_service):
                _reset(end) if connection.cut else end.close()


class _Connection:
    """Both directions of one connection."""

    def __init__(self, link: BadLink, number: int) -> None:
        self.fault = link.fault()
        self.cut = False
        self._link = link
        self._number = number
        self._ended = asyncio.Event()
        self._passed = 0

    async def pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Pass bytes on until the reader ends or the fault strikes in either direction."""
        ended = asyncio.create_task(self._ended.wait())
        try:
            while not self._ended.is_set():
                reading = asyncio.create_task(reader.read(CHUNK_BYTES))
                await asyncio.wait((reading, ended), return_when=asyncio.FIRST_COMPLETED)
                if not reading.done():
                    reading.cancel()
                    break
                chunk = reading.result()
                if not await self._link.passes(self._number):
                    self._strike()
                elif chunk:
                    await self._pass(chunk, writer)
                else:
                    break
            if writer.can_write_eof() and not self.cut:
                writer.write_eof()
        except OSError:
            # An end that resets is gone: the other must not wait for it.
            self._ended.set()
        ended.cancel()

    async def _pass(self, chunk: bytes, writer: asyncio.StreamWriter) -> None:
        if self.fault.delay_s:
            await asyncio.sleep(self.fault.delay_s)
        if self.fault.bytes_per_s is not None:
            await asyncio.sleep(len(chunk) / self.fault.bytes_per_s)
        before, self._passed = self._passed, self._passed + len(chunk)
        if self.fault.silent_after is not None:
            chunk = chunk[: max(0, self.fault.silent_after - before)]
        if self.fault.cut_after is not None and self._passed >= self.fault.cut_after:
            chunk = chunk[: max(0, self.fault.cut_after - before)]
            self._strike()
        writer.write(chunk)
        await writer.drain()

    def _strike(self) -> None:
        self.cut = True
        self._ended.set()


def _reset(writer: asyncio.StreamWriter) -> None:
    end: socket.socket | None = writer.get_extra_info("socket")
    if end is not None and end.fileno() >= 0:
        with contextlib.suppress(OSError):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
    writer.transport.abort()


@contextmanager
def bad_link(target: str, fault: Callable[[], Fault] = lambda: WHOLE) -> Iterator[BadLink]:
    """A link to `target`, on an event loop of its own, until the block ends."""
    link = BadLink(target, fault)
    ready, stop = threading.Event(), asyncio.Event()
    loop = asyncio.new_event_loop()

    async def serve() -> None:
        server = await asyncio.start_server(link.accept, "127.0.0.1", 0)
        link.port = server.sockets[0].getsockname()[1]
        ready.set()
        await stop.wait()
        server.close()
        under_way = asyncio.all_tasks() - {asyncio.current_task()}
        for task in under_way:
            task.cancel()
        await asyncio.gather(*under_way, return_exceptions=True)

    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()), name="bad link", daemon=True)
    thread.start()
    assert ready.wait(PATIENCE_S)
    try:
        yield link
    finally:
        loop.call_soon_threadsafe(stop.set)
        thread.join(PATIENCE_S)
        loop.close()
