"""The gateways of one store: each knows how many there are, and one of them keeps the store for all."""

from __future__ import annotations

import secrets
import time
from collections.abc import Awaitable, Callable

from revisit.service.capacity.budget import GatewayShare
from revisit.service.domain.processes import LivingProcess, ProcessRole
from revisit.service.ports.processes import GONE_AFTER_MS
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork

SHOWN_EVERY_S = 1.0
"""How often a gateway shows itself."""

KEEPS_FOR_S = 5.0
"""A keeper that could not show itself for so long begins no chore: it has ended by the time another one keeps."""


class Gateways:
    """This gateway among those of the store. The one that came first keeps the store."""

    def __init__(self, storage: Storage, share: GatewayShare, now_s: Callable[[], float] = time.monotonic) -> None:
        """`share` is told how many gateways there are; `now_s` is a monotonic clock, seconds."""
        self._storage = storage
        self._share = share
        self._now_s = now_s
        self._me = LivingProcess(f"gateway-{secrets.token_hex(4)}", ProcessRole.GATEWAY)
        self._first = self._was_first = False
        self._shown_at_s = float("-inf")

    @property
    def keeps(self) -> bool:
        """Whether this gateway keeps the store: whether it was the first of them the last two times."""
        return self._first and self._was_first and self._now_s() - self._shown_at_s < KEEPS_FOR_S

    async def show(self) -> None:
        """Show itself, and see who else is there."""
        began_s = self._now_s()
        await self._storage.write(lambda uow: uow.processes.announce(self._me))
        living = await self._storage.read(_gateways)
        self._share.gateways = max(1, len(living))
        self._was_first, self._first = self._first, living[:1] == [self._me]
        self._shown_at_s = began_s

    async def leave(self) -> None:
        """The others need not wait until it counts no more."""
        self._first = False
        await self._storage.write(lambda uow: uow.processes.forget(self._me.process_id))

    def of_keeper(self, work: Callable[[], Awaitable[None]]) -> Callable[[], Awaitable[None]]:
        """The work of the gateway that keeps the store."""

        async def work_of_keeper() -> None:
            if self.keeps:
                await work()

        return work_of_keeper


def _gateways(uow: UnitOfWork) -> list[LivingProcess]:
    return uow.processes.alive(ProcessRole.GATEWAY, GONE_AFTER_MS)
