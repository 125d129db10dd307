"""Work in flight: rate limits in points a second, the clouds and streams that are open, and turns of the tenants.

A request beyond a limit is refused at once and told when to come back, so that accepted requests stay fast under
overload. The unit of a rate limit is the point, because the cost of a request grows with its points.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice

from revisit.core.errors import RevisitError
from revisit.service.capacity.budget import Budget, GatewayShare, Held, Rate, RateBudget, Remembered, wait_while
from revisit.service.capacity.limits import (
    BESIDE_OTHERS,
    CALL_POINTS,
    CLOUD_POLL_S,
    CLOUD_POLLS,
    DECODERS,
    OTHERS_S,
    OVERLOAD_S,
    SLOT_RETRY_S,
    CapacityLimits,
)
from revisit.service.domain.errors import RateLimited, WorkersBusy
from revisit.service.domain.identity import TenantId


@dataclass(eq=False)
class _Reservation:
    """A cloud in flight. `prepaid` points were charged for it; the difference is settled once it is decoded."""

    tenant: TenantId
    prepaid: int
    decoded: bool = False


class InFlight:
    """Counts clouds and streams in flight and holds the rate limits. All calls come from the event loop."""

    def __init__(
        self,
        limits: CapacityLimits = CapacityLimits(),
        client: Callable[[], str] = lambda: "",
        now_s: Callable[[], float] = time.monotonic,
        note_refused: Callable[[TenantId, str], None] = lambda _tenant, _client: None,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
        share: GatewayShare | None = None,
    ) -> None:
        """`client` names the caller of the current request within its tenant; `now_s` is a monotonic clock, seconds.

        `note_refused` gets the caller that a rate limit refuses; `sleep` waits for so many seconds. A
        tenant and a client get this gateway's `share` of their limits.
        """
        self.limits = limits
        self._share = share or GatewayShare()
        self._client = client
        self._now_s = now_s
        self._note_refused = note_refused
        self._sleep = sleep
        self._rates = RateBudget(now_s, math.inf)
        self._clouds = Budget(self._has_slot)
        self._decoded: Held[TenantId] = Held()
        self._sent_s: Remembered[TenantId, float] = Remembered(math.inf)
        self._last_points: dict[TenantId, int] = {}
        self._overloaded_until_s: dict[TenantId, float] = {}
        self._streams: Held[tuple[str, ...]] = Held()

    @property
    def clouds(self) -> int:
        """Clouds in flight."""
        return self._clouds.held.total()

    @property
    def streams(self) -> int:
        """Open streams."""
        return self._streams.total()

    def clouds_of(self, tenant: TenantId) -> int:
        """The tenant's clouds in flight."""
        return self._clouds.held[tenant]

    def others_wait(self, tenant: TenantId) -> bool:
        """Whether a cloud of another tenant is in flight."""
        return self.clouds > self.clouds_of(tenant)

    def check_rate(self, tenant: TenantId) -> None:
        """Raises RateLimited where the client, its tenant or the service is over its rate limit."""
        wait_s = self._rates.wait_s(self._rates_of(tenant))
        if wait_s > 0.0:
            self._note_refused(tenant, self._client())
            raise RateLimited(retry_after_s=wait_s)

    def charge_call(self, tenant: TenantId, points: int) -> None:
        """Charge a request and its points to the rate limits."""
        self._rates.take(self._rates_of(tenant), points + CALL_POINTS)

    def note_overload(self, tenant: TenantId) -> None:
        """The tenant was refused: no waiting line for its clouds for `OVERLOAD_S`."""
        self._overloaded_until_s[tenant] = self._now_s() + OVERLOAD_S

    def check_slot(self, tenant: TenantId) -> None:
        """Raises WorkersBusy where no further cloud may be in flight."""
        if not self._has_slot(tenant, 1):
            self.note_overload(tenant)
            message = f"{self.clouds} clouds are in flight; try again with the same id"
            raise WorkersBusy(message, retry_after_s=SLOT_RETRY_S)

    @asynccontextmanager
    async def reserve_cloud(
        self, tenant: TenantId, refused_points: int = 0, *, patient: bool = False
    ) -> AsyncIterator[Callable[[int], None]]:
        """Reserve the slot of one cloud until it is stored; call the given function with its points once decoded.

        Points are charged in advance, as many as the tenant's last cloud had; the difference is charged or refunded
        once the cloud is decoded. Otherwise a burst of clouds would pass the limit before any of them is counted.
        One that is refused is charged `refused_points`: reading it took as long.
        Raises WorkersBusy where all slots, or the tenant's share of them, are taken. A `patient` cloud waits for a slot
        instead: one of a stream, which sends its next cloud after the answer. Any waits for a moment where the tenant
        has several under way and others send some, too.
        """
        await self._let_others_in(tenant)
        if patient:
            await self._clouds.enter(tenant)
        else:
            self.check_slot(tenant)
            self._clouds.take(tenant)
        self._sent_s[tenant] = self._now_s()
        reservation = _Reservation(tenant, self._last_points.get(tenant, 0))
        self.charge_call(tenant, reservation.prepaid)
        try:
            yield partial(self._count, reservation)
        except RevisitError:
            if not reservation.decoded:
                self._charge_difference(reservation, refused_points)
            raise
        finally:
            if not reservation.decoded:
                self._charge_difference(reservation, 0)
            self._decoded.add(tenant, -1)
            self._clouds.give(tenant)

    @contextmanager
    def reserve_stream(self, tenant: TenantId, *, replaces: bool) -> Iterator[None]:
        """Reserve the slot of one stream. A stream that `replaces` another may exceed the limit by one meanwhile.

        Raises RateLimited where the client or the service has as many streams as allowed.
        """
        key, more = (tenant, self._client()), int(replaces)
        own, overall = self._streams[key], self.streams
        if own >= self._share.of_whole(self.limits.client_streams) + more or overall >= self.limits.streams + more:
            raise RateLimited(f"{own} streams of this client and {overall} in all are open", retry_after_s=SLOT_RETRY_S)
        self._streams.add(key, 1)
        try:
            yield
        finally:
            self._streams.add(key, -1)

    async def _let_others_in(self, tenant: TenantId) -> None:
        """Return once the tenant has few clouds under way, or no other tenant sends any, or it has waited enough."""

        def crowded() -> bool:
            return self.clouds_of(tenant) >= BESIDE_OTHERS and self._beside_others(tenant)

        await wait_while(crowded, CLOUD_POLL_S, CLOUD_POLLS, self._sleep)

    def _beside_others(self, tenant: TenantId) -> bool:
        """Whether another tenant has sent a cloud of late."""
        of_others = (sent_s for one, sent_s in islice(reversed(self._sent_s.items()), 2) if one != tenant)
        return self._now_s() - max(of_others, default=-OTHERS_S) < OTHERS_S

    def _has_slot(self, holder: str, more: int) -> bool:
        tenant, share = TenantId(holder), max(1, int(self.limits.clouds * self.limits.tenant_share))
        if self.clouds + more > self.limits.clouds or self.clouds_of(tenant) + more > share:
            return False
        overloaded = self._now_s() < self._overloaded_until_s.get(tenant, 0.0)
        return not overloaded or self.clouds_of(tenant) - self._decoded[tenant] < DECODERS

    def _count(self, reservation: _Reservation, points: int) -> None:
        """The cloud is decoded and has so many points; as many are charged in advance for the next one."""
        self._last_points[reservation.tenant] = points
        self._charge_difference(reservation, points)

    def _charge_difference(self, reservation: _Reservation, points: int) -> None:
        """Charge, or refund, the difference to the prepayment; another cloud may wait for a decoder."""
        reservation.decoded = True
        self._rates.take(self._rates_of(reservation.tenant), points - reservation.prepaid)
        self._decoded.add(reservation.tenant, 1)
        self._clouds.wake()

    def _rates_of(self, tenant: TenantId) -> tuple[Rate, ...]:
        """Of the service, the tenant and the client. Their number is that of the credentials: no client can add one."""
        limits, client = self.limits, self._client()
        rates = {
            (): limits.points_per_s,
            (tenant,): self._share.of(limits.tenant_points_per_s),
            (tenant, client): self._share.of(limits.client_points_per_s),
        }
        return tuple(Rate(holder, per_s, per_s * limits.burst_s) for holder, per_s in rates.items())


class Turns:
    """Shares a few places between tenants, however much one of them asks for. All calls come from the event loop."""

    def __init__(self, places: int, of_tenant: int | None = None) -> None:
        """At most `places` are working, of them `of_tenant` of one tenant (None: as many as there are)."""
        self._places = places
        self._of_tenant = of_tenant or places
        self._working = Budget(self._has_place, in_turns=True)

    @property
    def waiting(self) -> int:
        """Those that wait for their turn."""
        return self._working.waiting

    @asynccontextmanager
    async def of(self, tenant: TenantId) -> AsyncIterator[None]:
        """Work within the block, when it is the tenant's turn."""
        await self._working.enter(tenant)
        try:
            yield
        finally:
            self._working.give(tenant)

    def _has_place(self, tenant: str, more: int) -> bool:
        working = self._working.held
        return working.total() + more <= self._places and working[tenant] + more <= self._of_tenant
