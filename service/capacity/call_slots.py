"""The slot of each call: kinds of calls have slots of their own, and tenants share them, over either transport.

Without this, one client with enough long calls closes the port to everyone. A call that waits gives its slot to
others for as long and holds one of those for waits.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from revisit.service.capacity.limits import CallLimits
from revisit.service.capacity.slots import Slots


class CallSlots:
    """The slots of one transport."""

    def __init__(self, limits: CallLimits = CallLimits()) -> None:
        self.calls = Slots(limits.calls)
        self.waits = Slots(limits.waits)
        self.watches = Slots(limits.watches)
        self.streams = Slots(limits.streams)

    @contextmanager
    def hold(
        self, kind: Slots, tenant: str, client: str, gone: Callable[[], Awaitable[None]] | None = None
    ) -> Iterator[None]:
        """Hold a slot of `kind` for a call of the tenant's client, which was admitted, until the block ends.

        `gone` returns once the client has left; None where the transport cancels the call then. Raises RateLimited.
        """
        call = _Call(self, kind, tenant, client, gone)
        kind.take(call.tenant, call.client)
        _CALL.set(call)
        try:
            yield
        finally:
            call.kind.give(call.tenant, call.client)


@dataclass
class _Call:
    """A call, and the kind of the slot that it holds now."""

    slots: CallSlots
    kind: Slots
    tenant: str
    client: str
    gone: Callable[[], Awaitable[None]] | None

    @contextmanager
    def as_one_of(self, kind: Slots) -> Iterator[None]:
        """Hold a slot of `kind` instead until the block ends. Raises RateLimited, and keeps its slot."""
        if self.kind is kind:
            yield
            return
        kind.take(self.tenant, self.client)
        before, self.kind = self.kind, kind
        before.give(self.tenant, self.client)
        try:
            yield
        finally:
            self.kind = before
            kind.give(self.tenant, self.client)
            before.take_back(self.tenant, self.client)


_CALL: ContextVar[_Call] = ContextVar("call")
"""Of the current task, which serves one call."""


class Wait:
    """A wait for which somebody still asks, or not."""

    abandoned = False
    """Whether the client has left: nobody reads the answer."""

    def abandon(self, watch: asyncio.Task[None]) -> None:
        """The client has left, or sends no valid request any longer."""
        self.abandoned = True
        if not watch.cancelled():
            watch.exception()


@contextmanager
def waiting() -> Iterator[Wait]:
    """Within the block the current call waits: it holds a slot for waits. Raises RateLimited."""
    call, wait = _CALL.get(None), Wait()
    if call is None:
        yield wait
        return
    with call.as_one_of(call.slots.waits):
        watch = None if call.gone is None else asyncio.ensure_future(call.gone())
        try:
            if watch is not None:
                watch.add_done_callback(wait.abandon)
            yield wait
        finally:
            if watch is not None:
                watch.cancel()


@contextmanager
def watching() -> Iterator[None]:
    """Within the block the current call is a watch and holds a slot for watches. Raises RateLimited."""
    call = _CALL.get()
    with call.as_one_of(call.slots.watches):
        yield
