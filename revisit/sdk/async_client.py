"""The client for programs on an event loop: the calls of `Client`, each awaited.

Calls run in threads of the client over the same transports. gRPC's own asynchronous client is not used: the end of a
call that it loses (`grpc_answers`) could not be waited for with a limit of ours.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from contextvars import copy_context
from functools import partial, wraps
from typing import Any

from revisit.sdk.client import Client, ScanStream
from revisit.sdk.conversations import Conversation

CALLS_AT_A_TIME = 32
"""Threads of a client; an open watch has one of them."""

_END = object()


class Threads:
    """The threads of one client."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(CALLS_AT_A_TIME, "revisit client")

    def awaited(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function as a coroutine that waits for a thread."""

        @wraps(function)
        async def run(*given: Any, **named: Any) -> Any:
            loop = asyncio.get_running_loop()
            # The thread has the time limit of the caller.
            return await loop.run_in_executor(self._pool, partial(copy_context().run, function, *given, **named))

        return run

    async def each(self, items: Iterable[Any]) -> AsyncIterator[Any]:
        """The items as they come."""
        following = self.awaited(next)
        iterator = iter(items)
        while (item := await following(iterator, _END)) is not _END:
            yield item

    def close(self) -> None:
        """Take no further calls; those under way end."""
        self._pool.shutdown(wait=False)


class AwaitedGroup:
    """A group of calls, each awaited."""

    def __init__(self, group: Any, threads: Threads) -> None:
        self._group = group
        self._threads = threads

    def __getattr__(self, name: str) -> Any:
        """A call of the group."""
        if name.startswith("_"):
            raise AttributeError(name)
        return self._threads.awaited(getattr(self._group, name))


class AsyncClient:
    """`Client` for an event loop: `await client.maps.get("yard")`, `async for event in client.watch("yard")`.

    Made and closed as `Client` is. Every call raises `revisit.sdk.errors.ApiError`.
    """

    def __init__(self, *given: Any, **named: Any) -> None:
        """As `Client`."""
        self._take(Client(*given, **named))

    @classmethod
    def grpc(cls, *given: Any, **named: Any) -> AsyncClient:
        """As `Client.grpc`."""
        made = cls.__new__(cls)
        made._take(Client.grpc(*given, **named))
        return made

    def _take(self, client: Client) -> None:
        self._client = client
        self._threads = Threads()
        for name, group in client.groups.items():
            setattr(self, name, AwaitedGroup(group, self._threads))
        for name in ("delete", "status", "explain", "holds_scan"):
            setattr(self, name, self._threads.awaited(getattr(client, name)))

    async def watch(self, *given: Any, **named: Any) -> AsyncIterator[Any]:
        """As `Client.watch`. Leave the loop to end it."""
        with self._client.watch(*given, **named) as watch:
            async for event in self._threads.each(watch):
                yield event

    async def watch_corrections(self, *given: Any, **named: Any) -> AsyncIterator[Any]:
        """As `Client.watch_corrections`. Leave the loop to end it."""
        with self._client.watch_corrections(*given, **named) as watch:
            async for correction in self._threads.each(watch):
                yield correction

    @asynccontextmanager
    async def stream(self, *given: Any, **named: Any) -> AsyncIterator[AwaitedStream]:
        """As `Client.stream`: on leaving, every scan was answered."""
        opened = self._client.stream(*given, **named)
        stream = await self._threads.awaited(opened.__enter__)()
        try:
            yield AwaitedStream(stream, self._threads)
        except BaseException as error:
            await self._threads.awaited(opened.__exit__)(type(error), error, error.__traceback__)
            raise
        await self._threads.awaited(opened.__exit__)(None, None, None)

    @asynccontextmanager
    async def relocalise(self, *given: Any, **named: Any) -> AsyncIterator[AwaitedConversation]:
        """As `Client.relocalise`."""
        with self._client.relocalise(*given, **named) as conversation:
            yield AwaitedConversation(conversation, self._threads)

    async def close(self) -> None:
        """Let go of the connections."""
        await self._threads.awaited(self._client.close)()
        self._threads.close()

    async def __aenter__(self) -> AsyncClient:
        """The client itself."""
        return self

    async def __aexit__(self, *_: object) -> None:
        """Let go of the connections."""
        await self.close()


class AwaitedConversation:
    """An open conversation: `Conversation` with `see` awaited."""

    def __init__(self, conversation: Conversation, threads: Threads) -> None:
        self._conversation = conversation
        self.see = threads.awaited(conversation.see)

    def __getattr__(self, name: str) -> Any:
        """The state of the conversation."""
        return getattr(self._conversation, name)


class AwaitedStream:
    """The open stream of a session: `ScanStream` with `send` and `flush` awaited."""

    def __init__(self, stream: ScanStream, threads: Threads) -> None:
        self._stream = stream
        self.send = threads.awaited(stream.send)
        self.flush = threads.awaited(stream.flush)

    def __getattr__(self, name: str) -> Any:
        """The state of the stream."""
        return getattr(self._stream, name)
