"""Turns: so many at a time, tenants one after the other, the work of each in the order it came."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from revisit.service.application.contract.identity import TenantId


class Turns:
    """Shares a few places between tenants, however much one of them asks for. All calls come from the event loop."""

    def __init__(self, places: int, of_tenant: int | None = None) -> None:
        """At most `places` are working, of them `of_tenant` of one tenant (None: as many as there are)."""
        self._free = places
        self._of_tenant = of_tenant or places
        self._working: Counter[TenantId] = Counter()
        self._waiting: dict[TenantId, deque[asyncio.Future[None]]] = {}

    @asynccontextmanager
    async def of(self, tenant: TenantId) -> AsyncIterator[None]:
        """Work within the block, when it is the tenant's turn."""
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(tenant, deque()).append(turn)
        self._give()
        try:
            await turn
            yield
        finally:
            self._leave(tenant, turn)

    def _give(self) -> None:
        """Give free places to the tenants that have waited longest since their last turn."""
        for tenant in tuple(self._waiting):
            if self._free and self._working[tenant] < self._of_tenant:
                queue = self._waiting.pop(tenant)
                queue.popleft().set_result(None)
                self._free -= 1
                self._working[tenant] += 1
                if queue:
                    # To the end of the line.
                    self._waiting[tenant] = queue

    def _leave(self, tenant: TenantId, turn: asyncio.Future[None]) -> None:
        """The work is done, or its caller went away while it waited."""
        queue = self._waiting.get(tenant, deque())
        if turn in queue:
            queue.remove(turn)
            if not queue:
                del self._waiting[tenant]
            return
        self._free += 1
        self._working[tenant] -= 1
        if not self._working[tenant]:
            del self._working[tenant]
        self._give()
