"""Shared polling: one query serves all waiters of a key."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Hashable
from functools import partial
from typing import Generic, TypeVar

from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork

K = TypeVar("K", bound=Hashable)
I = TypeVar("I", bound=Hashable)  # noqa: E741  # an item


class SharedPoll(Generic[K, I]):
    """Waiters for items of the same key share a query. All calls come from the event loop."""

    def __init__(self, storage: Storage, not_come: Callable[[UnitOfWork, K, frozenset[I]], Collection[I]]) -> None:
        """`not_come` says which of the items of a key are still to be waited for."""
        self._storage = storage
        self._not_come = not_come
        self._polls: dict[K, _Poll[I]] = {}
        self._reading: set[asyncio.Task[None]] = set()

    async def has_come(self, key: K, item: I, within_s: float) -> bool:
        """Poll within so many seconds, with all waiters; whether `item` has come. Raises the errors of the query."""
        poll = self._polls.get(key)
        if poll is None:
            poll = self._polls[key] = _Poll()
        poll.items.add(item)
        poll.begin_within(within_s, partial(self._begin, key))
        return item not in await asyncio.shield(poll.outcome)

    def _begin(self, key: K) -> None:
        reading = asyncio.get_running_loop().create_task(self._read(key, self._polls.pop(key)))
        self._reading.add(reading)
        reading.add_done_callback(self._reading.discard)

    async def _read(self, key: K, poll: _Poll[I]) -> None:
        items = frozenset(poll.items)
        try:
            poll.outcome.set_result(await self._storage.read(lambda uow: self._not_come(uow, key, items)))
        except Exception as error:  # noqa: BLE001  # all waiters get the error
            poll.outcome.set_exception(error)
            # They may all have gone away meanwhile.
            poll.outcome.exception()


class _Poll(Generic[I]):
    """A coming poll, and its items."""

    def __init__(self) -> None:
        self.items: set[I] = set()
        self.outcome: asyncio.Future[Collection[I]] = asyncio.get_running_loop().create_future()
        self._timer: asyncio.Handle | None = None
        self._due_s = 0.0

    def begin_within(self, seconds: float, begin: Callable[[], None]) -> None:
        """Begin in so many seconds, unless it begins earlier anyway."""
        loop = asyncio.get_running_loop()
        due_s = loop.time() + seconds
        if self._timer is not None:
            # Noted here: a timer of uvloop that is due at once does not know when.
            if self._due_s <= due_s:
                return
            self._timer.cancel()
        self._timer, self._due_s = loop.call_later(seconds, begin), due_s
