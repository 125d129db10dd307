"""Work in flight: rate limits in points a second, the clouds and streams that are open, and turns of the tenants.

A request beyond a limit is refused at once and told when to come back, so that accepted requests stay fast under
overload. The unit of a rate limit is the point, because the cost of a request grows with its points.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections import Counter, deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import islice

from revisit.core.errors import RevisitError
from revisit.service.domain.errors import RateLimited, WorkersBusy
from revisit.service.domain.identity import TenantId

CALL_POINTS = 1_000
"""Charge of a request beside its points."""

POINTS_PER_S = 10_000_000
"""Points a second of a core: a point is a tenth of a microsecond."""

BUSY_RETRY_S = 1.0
"""When to come back where all slots are taken."""

DECODERS = max(2, os.cpu_count() or 2)
"""Threads that decode clouds. More threads than cores would only slow the event loop down."""

OVERLOAD_S = 10.0
"""For so long after a refusal, a tenant may have no more undecoded clouds than there are `DECODERS`: under lasting
overload a waiting line would only add to the latency of each request."""

BESIDE_OTHERS = 3
"""Clouds that a tenant has under way at a time where another has sent one within `OTHERS_S`. They take turns anyway at
the interpreter and the writer; more of them only make the others' wait longer."""

OTHERS_S = 5.0
POLL_S, POLLS = 0.005, 10
"""A further cloud of the tenant looks so often, and goes on in any case afterwards."""


@dataclass(frozen=True)
class CapacityLimits:
    """The limits of an installation. Rates are points a second, averaged over `burst_s`."""

    points_per_s: float = 40e6
    tenant_points_per_s: float = 20e6
    client_points_per_s: float = 10e6
    burst_s: float = 10.0
    clouds: int = 4 * DECODERS
    """Clouds in flight: received and not yet stored."""
    tenant_share: float = 0.75
    """The share of those that one tenant may have."""
    streams: int = 256
    client_streams: int = 8


@dataclass
class TokenBucket:
    """Refilled with `per_s` tokens a second up to `burst`; times in seconds of a monotonic clock.

    More may be taken than there is. The balance is then negative until the rate has made up for it.
    """

    per_s: float
    burst: float
    balance: float
    at_s: float

    @classmethod
    def full(cls, per_s: float, burst: float, now_s: float) -> TokenBucket:
        """A bucket with a whole burst in it."""
        return cls(per_s, burst, burst, now_s)

    def wait_s(self, now_s: float, needed: float = 0.0) -> float:
        """Seconds until the balance is at least `needed`; 0 where it is."""
        self._refill(now_s)
        return max(0.0, (needed - self.balance) / self.per_s)

    def take(self, tokens: float, now_s: float) -> None:
        """Take tokens; a negative number gives them back."""
        self._refill(now_s)
        self.balance -= tokens

    def _refill(self, now_s: float) -> None:
        self.balance = min(self.burst, self.balance + (now_s - self.at_s) * self.per_s)
        self.at_s = now_s


async def wait_while(
    condition: Callable[[], bool], poll_s: float, polls: int, sleep: Callable[[float], Awaitable[None]]
) -> None:
    """Return once `condition` does not hold; it is checked every `poll_s` seconds, at most `polls` times."""
    for _ in range(polls):
        if not condition():
            return
        await sleep(poll_s)


@dataclass(eq=False)
class _Waiter:
    tenant: TenantId
    turn: asyncio.Future[None] = field(default_factory=lambda: asyncio.get_running_loop().create_future())


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
    ) -> None:
        """`client` names the caller of the current request within its tenant; `now_s` is a monotonic clock, seconds.

        `note_refused` gets the caller that a rate limit refuses; `sleep` waits for so many seconds.
        """
        self.limits = limits
        self._client = client
        self._now_s = now_s
        self._note_refused = note_refused
        self._sleep = sleep
        self._buckets: dict[tuple[str, ...], TokenBucket] = {}
        self._clouds: Counter[TenantId] = Counter()
        self._sent_s: dict[TenantId, float] = {}
        self._undecoded: Counter[TenantId] = Counter()
        self._last_points: dict[TenantId, int] = {}
        self._waiters: deque[_Waiter] = deque()
        self._overloaded_until_s: dict[TenantId, float] = {}
        self._streams: Counter[tuple[str, ...]] = Counter()

    @property
    def clouds(self) -> int:
        """Clouds in flight."""
        return self._clouds.total()

    @property
    def streams(self) -> int:
        """Open streams."""
        return self._streams.total()

    def clouds_of(self, tenant: TenantId) -> int:
        """The tenant's clouds in flight."""
        return self._clouds[tenant]

    def others_wait(self, tenant: TenantId) -> bool:
        """Whether a cloud of another tenant is in flight."""
        return self.clouds > self._clouds[tenant]

    def check_rate(self, tenant: TenantId) -> None:
        """Raises RateLimited where the client, its tenant or the service is over its rate limit."""
        now_s = self._now_s()
        wait_s = max(bucket.wait_s(now_s) for bucket in self._buckets_of(tenant))
        if wait_s > 0.0:
            self._note_refused(tenant, self._client())
            raise RateLimited(retry_after_s=wait_s)

    def charge_call(self, tenant: TenantId, points: int) -> None:
        """Charge a request and its points to the rate limits."""
        self._charge(tenant, points + CALL_POINTS)

    def note_overload(self, tenant: TenantId) -> None:
        """The tenant was refused: no waiting line for its clouds for `OVERLOAD_S`."""
        self._overloaded_until_s[tenant] = self._now_s() + OVERLOAD_S

    def check_slot(self, tenant: TenantId) -> None:
        """Raises WorkersBusy where no further cloud may be in flight."""
        if not self._has_slot(tenant):
            self.note_overload(tenant)
            message = f"{self.clouds} clouds are in flight; try again with the same id"
            raise WorkersBusy(message, retry_after_s=BUSY_RETRY_S)

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
        if patient and not self._has_slot(tenant):
            await self._turn(tenant)
        else:
            self.check_slot(tenant)
            self._enter(tenant)
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
            self._leave(tenant)

    @contextmanager
    def reserve_stream(self, tenant: TenantId, *, replaces: bool) -> Iterator[None]:
        """Reserve the slot of one stream. A stream that `replaces` another may exceed the limit by one meanwhile.

        Raises RateLimited where the client or the service has as many streams as allowed.
        """
        key, more = (tenant, self._client()), int(replaces)
        own, overall = self._streams[key], self.streams
        if own >= self.limits.client_streams + more or overall >= self.limits.streams + more:
            raise RateLimited(f"{own} streams of this client and {overall} in all are open", retry_after_s=BUSY_RETRY_S)
        self._streams[key] += 1
        try:
            yield
        finally:
            self._streams[key] -= 1
            if not self._streams[key]:
                del self._streams[key]

    async def _let_others_in(self, tenant: TenantId) -> None:
        """Return once the tenant has few clouds under way, or no other tenant sends any, or it has waited enough."""

        def crowded() -> bool:
            return self._clouds[tenant] >= BESIDE_OTHERS and self._beside_others(tenant)

        await wait_while(crowded, POLL_S, POLLS, self._sleep)

    def _beside_others(self, tenant: TenantId) -> bool:
        """Whether another tenant has sent a cloud of late."""
        of_others = (sent_s for one, sent_s in islice(reversed(self._sent_s.items()), 2) if one != tenant)
        return self._now_s() - max(of_others, default=-OTHERS_S) < OTHERS_S

    def _has_slot(self, tenant: TenantId) -> bool:
        share = max(1, int(self.limits.clouds * self.limits.tenant_share))
        if self.clouds >= self.limits.clouds or self._clouds[tenant] >= share:
            return False
        overloaded = self._now_s() < self._overloaded_until_s.get(tenant, 0.0)
        return not overloaded or self._undecoded[tenant] < DECODERS

    async def _turn(self, tenant: TenantId) -> None:
        """Wait for a slot; it is taken when this returns."""
        waiter = _Waiter(tenant)
        self._waiters.append(waiter)
        try:
            await waiter.turn
        except asyncio.CancelledError:
            if waiter in self._waiters:
                self._waiters.remove(waiter)
            else:
                self._undecoded[tenant] -= 1
                self._leave(tenant)
            raise

    def _enter(self, tenant: TenantId) -> None:
        self._sent_s.pop(tenant, None)
        self._sent_s[tenant] = self._now_s()
        self._clouds[tenant] += 1
        self._undecoded[tenant] += 1

    def _count(self, reservation: _Reservation, points: int) -> None:
        """The cloud is decoded and has so many points; as many are charged in advance for the next one."""
        self._last_points[reservation.tenant] = points
        self._charge_difference(reservation, points)

    def _charge_difference(self, reservation: _Reservation, points: int) -> None:
        """Charge, or refund, the difference to the prepayment; another cloud may wait for a decoder."""
        reservation.decoded = True
        self._charge(reservation.tenant, points - reservation.prepaid)
        self._undecoded[reservation.tenant] -= 1
        self._wake()

    def _leave(self, tenant: TenantId) -> None:
        self._clouds[tenant] -= 1
        self._wake()

    def _wake(self) -> None:
        """Give free slots to those that have waited longest."""
        for waiter in tuple(self._waiters):
            if self._has_slot(waiter.tenant):
                self._waiters.remove(waiter)
                self._enter(waiter.tenant)
                waiter.turn.set_result(None)

    def _charge(self, tenant: TenantId, points: int) -> None:
        now_s = self._now_s()
        for bucket in self._buckets_of(tenant):
            bucket.take(points, now_s)

    def _buckets_of(self, tenant: TenantId) -> tuple[TokenBucket, ...]:
        """Of the service, the tenant and the client. Their number is that of the credentials: no client can add one."""
        limits = self.limits
        rates = {
            (): limits.points_per_s,
            (tenant,): limits.tenant_points_per_s,
            (tenant, self._client()): limits.client_points_per_s,
        }
        return tuple(self._bucket(key, per_s) for key, per_s in rates.items())

    def _bucket(self, key: tuple[str, ...], per_s: float) -> TokenBucket:
        if key not in self._buckets:
            self._buckets[key] = TokenBucket.full(per_s, per_s * self.limits.burst_s, self._now_s())
        return self._buckets[key]


class Turns:
    """Shares a few slots between tenants, however much one of them asks for. All calls come from the event loop."""

    def __init__(self, slots: int, of_tenant: int | None = None) -> None:
        """At most `slots` are working, of them `of_tenant` of one tenant (None: as many as there are)."""
        self._free = slots
        self._of_tenant = of_tenant or slots
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
        """Give free slots to the tenants that have waited longest since their last turn."""
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
