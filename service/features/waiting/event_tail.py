"""The tail of a map's events: one read for all watches."""

from __future__ import annotations

import asyncio

from revisit.service.capacity.admission import Admission
from revisit.service.domain.identity import TenantId
from revisit.service.ports.storage import Storage

POLL_EVERY_S = 0.2
"""How often the log of events is looked at while anybody watches."""

AGAIN_S = 1.0
"""A watch that is told of nothing looks itself after this long: a map that is deleted leaves no event."""

MOST_MAPS = 10_000
"""Maps with their newest event in memory."""


class EventTail:
    """The tail of the log of events, read once for all waiters.

    A watch holds nothing but the number up to which it has read, so a client that reads slowly costs no memory.
    """

    def __init__(self, storage: Storage, admission: Admission, every_s: float = POLL_EVERY_S) -> None:
        """At most one look in `every_s` seconds. Waiting ends when `admission` says that the service stops."""
        self._storage = storage
        self._admission = admission
        self._every_s = every_s
        self._next: asyncio.Task[None] | None = None
        self._last: int | None = None
        self._forgotten = 0
        self._newest: dict[tuple[TenantId, str], int] = {}

    @property
    def last(self) -> int:
        """The last number of the log as of the last look; 0 before the first."""
        return self._last or 0

    async def beyond(self, tenant: TenantId, map_id: str, number: int, at_most_s: float = AGAIN_S) -> bool:
        """Wait until something happened in the map after the log had `number`, or for so long; which of the two."""
        until_s = asyncio.get_running_loop().time() + at_most_s
        while not self._admission.stopping:
            await self._poll()
            if self._newest_in(tenant, map_id) > number:
                return True
            if asyncio.get_running_loop().time() >= until_s:
                break
        return False

    def _newest_in(self, tenant: TenantId, map_id: str) -> int:
        """The number of the map's newest event, or one that is not below it."""
        known = (self._newest.get((tenant, of), self._forgotten) for of in (map_id, ""))
        return max(known)

    async def _poll(self) -> None:
        if self._next is None or self._next.done():
            self._next = asyncio.create_task(self._read_tail())
        await asyncio.shield(self._next)

    async def _read_tail(self) -> None:
        await asyncio.sleep(self._every_s)
        if self._last is None:
            self._last = self._forgotten = await self._storage.read(lambda uow: uow.events.last_number())
            return
        for event in await self._storage.read(lambda uow: uow.events.newest_of_maps(self.last)):
            self._newest[event.tenant, event.map_id] = event.number
            self._last = max(self.last, event.number)
        if len(self._newest) > MOST_MAPS:
            self._newest.clear()
            self._forgotten = self.last
