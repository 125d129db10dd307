"""The budget of bytes in flight: bodies, messages and files that the gateway holds for its clients, with a ceiling."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager

from revisit.service.capacity.budget import Budget
from revisit.service.capacity.limits import BYTES_IN_FLIGHT, BYTES_PATIENCE_S, BYTES_RETRY_S, TENANT_SHARE
from revisit.service.domain.errors import WorkersBusy
from revisit.service.domain.identity import TenantId


class HeldBytes:
    """One request's share of the budget."""

    def __init__(self, budget: ByteBudget, tenant: TenantId) -> None:
        self._budget = budget
        self._tenant = tenant
        self.bytes = 0

    async def wait_for(self, count: int) -> None:
        """Hold `count` bytes from now on. Raises WorkersBusy where there is no room for so long."""
        more = count - self.bytes
        if self._budget.has_room(self._tenant, more):
            self._budget.take(self._tenant, more)
        else:
            await self._budget.enter(self._tenant, more)
        self.bytes = count

    def set(self, count: int) -> None:
        """Hold `count` bytes from now on. Raises WorkersBusy, and keeps its former share, where there is no room."""
        self._budget.take(self._tenant, count - self.bytes)
        self.bytes = count


class ByteBudget:
    """Counts the bytes that are held, in all and by tenant. All calls come from the event loop."""

    def __init__(self, most_bytes: int = BYTES_IN_FLIGHT, patience_s: float = BYTES_PATIENCE_S) -> None:
        """At most `most_bytes` in all, of which a tenant has `TENANT_SHARE`."""
        self._most = most_bytes
        self._patience_s = patience_s
        self._budget = Budget(self.has_room)

    @property
    def held_bytes(self) -> int:
        """Held in all."""
        return self._budget.held.total()

    @contextmanager
    def hold(self, tenant: TenantId) -> Iterator[HeldBytes]:
        """The share of one request of `tenant`, nothing at first; all of it is released at the end of the block."""
        held = HeldBytes(self, tenant)
        try:
            yield held
        finally:
            held.set(0)

    def has_room(self, tenant: str, more: int) -> bool:
        """Whether `tenant` may hold `more` bytes."""
        share = int(self._most * TENANT_SHARE)
        return self.held_bytes + more <= self._most and self._budget.held[tenant] + more <= share

    def take(self, tenant: TenantId, more: int) -> None:
        """Count `more` bytes, or give them back where negative. Raises WorkersBusy where there is no room."""
        if more > 0 and not self.has_room(tenant, more):
            raise _full()
        self._budget.take(tenant, more)
        self._budget.wake()

    async def enter(self, tenant: TenantId, more: int) -> None:
        """Count `more` bytes as soon as there is room for them. Raises WorkersBusy."""
        try:
            async with asyncio.timeout(self._patience_s):
                await self._budget.enter(tenant, more)
        except TimeoutError as error:
            raise _full() from error


def _full() -> WorkersBusy:
    return WorkersBusy("too many bytes are in flight; try again later with the same id", retry_after_s=BYTES_RETRY_S)
