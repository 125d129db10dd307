"""A service in which no time passes for the pace of calls: whoever would wait goes on at once, and is counted."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from dataclasses import replace

from revisit.service.capacity.call_pace import CallPace
from revisit.service.capacity.limits import PaceLimits
from revisit.service.use_cases import UseCases
from tests.support.live_service import LiveService, live_service
from tests.support.service_world import World, memory_world

BURST = 3
LIMITS = PaceLimits(
    client_calls_per_s=BURST,
    tenant_calls_per_s=BURST,
    refusals_per_s=BURST,
    public_calls_per_s=BURST,
    burst=BURST,
    most_wait_s=1.0,
)
BEFORE_REFUSAL = 2 * BURST
"""Calls of one client: as many begin at once, as many wait, and the next one is refused."""


class Line:
    """Calls that wait are let go at once, and counted; no time passes."""

    def __init__(self) -> None:
        self.waited, self.pace = 0, CallPace(LIMITS, lambda: 0.0, self._wait)

    def start_anew(self) -> None:
        """Nobody has called yet."""
        self.waited = 0
        self.pace._rates._buckets.clear()

    async def _wait(self, _seconds: float) -> None:
        self.waited += 1
        await asyncio.sleep(0)


@contextlib.contextmanager
def paced_service(line: Line) -> Iterator[LiveService]:
    """A service with keys whose calls come at the pace of `line`."""
    made = memory_world()
    context = replace(made.context, pace=line.pace)
    with live_service(World(context, UseCases.over(context, "test"), made.clock)) as running:
        yield running
