"""The tail of the events of maps: one read for all watches."""

from __future__ import annotations

import asyncio
from collections import Counter

from revisit.service.capacity.admission import Admission
from revisit.service.domain.errors import NotFound
from revisit.service.domain.identity import TenantId
from revisit.service.ports.storage import Storage

POLL_EVERY_S = 0.2
"""How often the counters of maps are looked at while anybody watches."""

AGAIN_S = 1.0
"""A watch that is told of nothing is asked after this long whether it goes on."""

_MapKey = tuple[TenantId, str]
_Look = tuple[frozenset[_MapKey], dict[_MapKey, int]]
"""The maps that were asked for, and the last numbers of those that are there."""


class EventTail:
    """The last numbers of the events of the maps that are watched, read once for all waiters.

    A watch holds nothing but the number up to which it has read, so a client that reads slowly costs no memory.
    """

    def __init__(self, storage: Storage, admission: Admission, every_s: float = POLL_EVERY_S) -> None:
        """At most one look in `every_s` seconds. Waiting ends when `admission` says that the service stops."""
        self._storage = storage
        self._admission = admission
        self._every_s = every_s
        self._next: asyncio.Task[_Look] | None = None
        self._watched: Counter[_MapKey] = Counter()

    async def beyond(self, tenant: TenantId, map_id: str, number: int, at_most_s: float = AGAIN_S) -> int:
        """Wait for an event of the map above `number`, or for so long; the last number of the map.

        Raises NotFound where the map was deleted.
        """
        until_s, key = asyncio.get_running_loop().time() + at_most_s, (tenant, map_id)
        self._watched[key] += 1
        try:
            last = number
            while last <= number and not self._admission.stopping:
                asked, known = await self._poll()
                if key in asked - known.keys():
                    raise NotFound(f"there is no map {map_id!r}"[:200])
                last = max(number, known.get(key, number))  # below it only where it cannot be read
                if asyncio.get_running_loop().time() >= until_s:
                    break
            return last
        finally:
            self._watched[key] -= 1
            self._watched += Counter()

    async def _poll(self) -> _Look:
        if self._next is None or self._next.done():
            self._next = asyncio.create_task(self._read())
        return await asyncio.shield(self._next)

    async def _read(self) -> _Look:
        await asyncio.sleep(self._every_s)
        watched = frozenset(self._watched)
        return watched, await self._storage.read(lambda uow: uow.events.last_numbers(watched))
