"""Work of the gateway that takes as long as its input is large: in turns, and charged."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import TypeVar

from revisit.service.capacity.in_flight import InFlight, Turns
from revisit.service.capacity.limits import POINTS_PER_S
from revisit.service.domain.identity import TenantId

T = TypeVar("T")


class ChargedWork:
    """Makes files, and reads much: one at a time, for the largest takes several times its size for a moment, and
    tenants in turns.

    Each is charged its time of a core, also a failed one: a scene in glb takes hundreds of milliseconds.
    """

    def __init__(self, in_flight: InFlight) -> None:
        """All of it is charged to the rate limits of `in_flight`."""
        self._in_flight = in_flight
        self._turns = Turns(1)

    async def of(self, tenant: TenantId, make: Callable[[], T]) -> T:
        """The result of `make`, in a thread. Raises RateLimited, and the errors of `make`."""
        async with self._turns.of(tenant):
            self._in_flight.check_rate(tenant)
            spent_s: list[float] = []
            made = asyncio.create_task(asyncio.to_thread(_timed, make, spent_s))
            try:
                return await asyncio.shield(made)
            finally:
                # Of a caller that goes away, too: the thread works to its end.
                await asyncio.wait({made})
                self._in_flight.charge_call(tenant, int(POINTS_PER_S * sum(spent_s)))


def _timed(make: Callable[[], T], spent_s: list[float]) -> T:
    """The result of `make`; its time of a core, seconds, is added to `spent_s`."""
    began_s = time.thread_time()
    try:
        return make()
    finally:
        spent_s.append(time.thread_time() - began_s)
