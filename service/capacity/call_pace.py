"""The pace of calls: how many may begin each second. Further calls wait, and are refused only where many wait already.

A call costs the event loop about a millisecond, refused or not, and an answer does not stop a client from sending the
next call at once. Rate limits in points cannot help: a refused call costs that millisecond again.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial

from revisit.service.capacity.addresses import holder_of
from revisit.service.capacity.budget import GatewayShare, Rate, RateBudget, Remembered, wait_while
from revisit.service.capacity.limits import (
    CALL_POLL_S,
    CALL_POLLS,
    JSON_BYTES_A_CALL,
    MOST_CALLS_A_BODY,
    REFUSED_FOR_S,
    UNREAD_BYTES_A_CALL,
    PaceLimits,
)
from revisit.service.domain.errors import RateLimited
from revisit.service.domain.identity import TenantId


@dataclass
class _Line:
    """Calls that wait, at most so many."""

    most: int
    length: int = 0


class CallPace:
    """Holds calls back. All calls of its methods come from the event loop."""

    def __init__(
        self,
        limits: PaceLimits = PaceLimits(),
        now_s: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
        others_wait: Callable[[TenantId], bool] = lambda _tenant: False,
        share: GatewayShare | None = None,
    ) -> None:
        """`now_s` is a monotonic clock, seconds; `sleep` waits for so many.

        `others_wait` tells whether a cloud of another tenant is in flight. A tenant and a client get this gateway's
        `share` of their limits.
        """
        self._limits = limits
        self._share = share or GatewayShare()
        self._others_wait = others_wait
        self._now_s = now_s
        self._sleep = sleep
        self._rates = RateBudget(now_s)
        self._refused_until_s: Remembered[tuple[str, ...], float] = Remembered()
        self._callers, self._unauthenticated = _Line(limits.waiting), _Line(limits.unauthenticated_waiting)

    @property
    def waiting(self) -> int:
        """Calls that wait."""
        return self._callers.length + self._unauthenticated.length

    async def turn(self, tenant: TenantId, client: str) -> None:
        """Return when a call of the tenant's client may begin. Raises RateLimited where too many wait."""
        rates, over_rate = self._rates_of(tenant, client), ("over rate", tenant, client)
        if self._refused_until_s.get(over_rate, 0.0) <= self._now_s():
            await self._wait(self._callers, *rates)
            return
        await self._wait(self._callers, *rates, self._rate(over_rate, self._limits.over_rate_calls_per_s))
        await wait_while(partial(self._others_wait, tenant), CALL_POLL_S, CALL_POLLS, self._sleep)

    def note_refused(self, tenant: TenantId, client: str) -> None:
        """The client was told to come back later: if it does not wait by itself, it waits here."""
        self._refused_until_s["over rate", tenant, client] = self._now_s() + REFUSED_FOR_S

    def note_unread(self, tenant: TenantId, client: str, unread_bytes: int) -> None:
        """A body of the client was refused before it was read: its further calls wait for as long as that takes."""
        self._note(tenant, client, unread_bytes / UNREAD_BYTES_A_CALL)

    def note_json(self, tenant: TenantId, client: str, json_bytes: int) -> None:
        """So much JSON of the client is read, good or bad: its further calls wait for as long as that takes."""
        self._note(tenant, client, json_bytes / JSON_BYTES_A_CALL)

    def _note(self, tenant: TenantId, client: str, calls: float) -> None:
        self._rates.take(self._rates_of(tenant, client), min(calls, MOST_CALLS_A_BODY))

    async def refusal(self, address: str) -> None:
        """Return when a caller that nobody knows may be told so; at once where too many wait."""
        try:
            await self._wait(self._unauthenticated, self._of_stranger("refused", address, self._limits.refusals_per_s))
        except RateLimited:
            return

    async def public(self, address: str) -> None:
        """Return when a call without a credential may begin. Raises RateLimited where too many wait."""
        await self._wait(self._unauthenticated, self._of_stranger("public", address, self._limits.public_calls_per_s))

    async def _wait(self, line: _Line, *rates: Rate) -> None:
        """Spend a token of each rate and wait until they are there; a call that is given up has spent them, too."""
        wait_s = self._rates.wait_s(rates, 1.0)
        if wait_s > self._limits.most_wait_s or (wait_s > 0.0 and line.length >= line.most):
            raise RateLimited("too many calls wait already: begin fewer at a time", retry_after_s=wait_s)
        self._rates.take(rates)
        if wait_s > 0.0:
            line.length += 1
            try:
                await self._sleep(wait_s)
            finally:
                line.length -= 1

    def _rates_of(self, tenant: str, client: str) -> tuple[Rate, Rate]:
        limits = self._limits
        own = self._rate(("client", tenant, client), self._share.of(limits.client_calls_per_s))
        return own, self._rate(("tenant", tenant), self._share.of(limits.tenant_calls_per_s))

    def _of_stranger(self, kind: str, address: str, per_s: float) -> Rate:
        return self._rate((kind, holder_of(address)), per_s)

    def _rate(self, caller: tuple[str, ...], per_s: float) -> Rate:
        return Rate(caller, per_s, self._limits.burst)
