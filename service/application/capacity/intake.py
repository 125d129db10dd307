"""How much is taken in: points a second per client, tenant and service; clouds at a time; streams at a time.

What is over a bound is refused at once with the time to come back, so that what is taken in stays quick: an overloaded
service answers, it does not swell. Points are the unit, for their number is what a request costs.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from functools import partial

from revisit.service.application.contract.errors import RateLimited, WorkersBusy
from revisit.service.application.contract.identity import TenantId

CALL_POINTS = 1_000
"""What a call costs beside the points it brings."""

BUSY_RETRY_S = 1.0
QUEUE_RETRY_S = 5.0
"""When to come back where all places, or all places of the queue, are taken."""

DECODERS = max(2, os.cpu_count() or 2)
"""Clouds that are decoded at the same time: more threads than cores would only take the event loop's turns."""

CROWDED_S = 10.0
"""Clouds that come in a burst wait in line for a decoder. Where more keeps coming the line would never end, and each
wait for all before it: for so long after a refusal a tenant has no more undecoded clouds than `DECODERS`."""

RECOUNT_S = 0.05
"""A queue that seems to be full is counted again at most this often, so that finding it full costs next to nothing."""


@dataclass(frozen=True)
class IntakeLimits:
    """Bounds of one installation; rates are points a second, over `burst_s` on average."""

    points_per_s: float = 40e6
    tenant_points_per_s: float = 20e6
    client_points_per_s: float = 10e6
    burst_s: float = 10.0
    clouds: int = 4 * DECODERS
    """Clouds that are decoded and stored at the same time."""
    tenant_share: float = 0.75
    """Of those clouds: what one tenant may have of them, so that another finds a place."""
    streams: int = 256
    client_streams: int = 8


@dataclass
class Bucket:
    """Points that may still come, refilled at `per_s` a second up to `most`.

    A cloud is taken while there is any left, so the balance may be negative: then nothing is taken until that is made
    up for.
    """

    per_s: float
    most: float
    balance: float
    at_s: float

    def wait_s(self, now_s: float) -> float:
        """How long until there is any left, seconds; 0 where there is."""
        self._refill(now_s)
        return max(0.0, -self.balance / self.per_s)

    def take(self, points: int, now_s: float) -> None:
        """Pay with so many."""
        self._refill(now_s)
        self.balance -= points

    def _refill(self, now_s: float) -> None:
        self.balance = min(self.most, self.balance + (now_s - self.at_s) * self.per_s)
        self.at_s = now_s


@dataclass(eq=False)
class _Waiter:
    tenant: TenantId
    turn: asyncio.Future[None] = field(default_factory=lambda: asyncio.get_running_loop().create_future())


@dataclass(eq=False)
class _Place:
    """A cloud that is being taken in; so many points are `expected` of it and paid for, until it is `settled`."""

    tenant: TenantId
    expected: int
    settled: bool = False


class Intake:
    """The bounds and what is taken in now. All calls but `expect_waiting` come from the event loop."""

    def __init__(
        self,
        limits: IntakeLimits = IntakeLimits(),
        client: Callable[[], str] = lambda: "",
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """`client` says whose request is being answered, within its tenant; `now_s` is a monotonic clock in seconds."""
        self.limits = limits
        self._client = client
        self._now_s = now_s
        self._buckets: dict[tuple[str, ...], Bucket] = {}
        self._clouds: Counter[TenantId] = Counter()
        self._undecoded: Counter[TenantId] = Counter()
        self._last_points: dict[TenantId, int] = {}
        self._waiters: deque[_Waiter] = deque()
        self._crowded_until_s: dict[TenantId, float] = {}
        self._streams: Counter[tuple[str, ...]] = Counter()
        self._waiting: dict[TenantId, int] = {}
        self._recounted_s: dict[TenantId, float] = {}

    @property
    def clouds(self) -> int:
        """Clouds that are being taken in."""
        return self._clouds.total()

    @property
    def streams(self) -> int:
        """Streams that are open."""
        return self._streams.total()

    def require_points(self, tenant: TenantId) -> None:
        """Raises RateLimited where the client, its tenant or the service has had its points."""
        now_s = self._now_s()
        wait_s = max(bucket.wait_s(now_s) for bucket in self._buckets_of(tenant))
        if wait_s > 0.0:
            raise RateLimited(retry_after_s=wait_s)

    def spend(self, tenant: TenantId, points: int) -> None:
        """Pay for a call that brought so many points."""
        self._pay(tenant, points + CALL_POINTS)

    def expect_waiting(self, tenant: TenantId, jobs: int) -> None:
        """So many jobs of the tenant wait from now on, with the one that is being added; from any thread."""
        self._waiting[tenant] = jobs

    def note_recount(self, tenant: TenantId, jobs: int) -> None:
        """So many jobs of the tenant were just counted."""
        self._waiting[tenant], self._recounted_s[tenant] = jobs, self._now_s()

    def queue_seems_full(self, tenant: TenantId, most: int) -> bool:
        """Whether the jobs that wait, as far as is known, and the clouds that are being taken in make `most`."""
        return self._waiting.get(tenant, 0) + self._clouds[tenant] >= most

    def recounted_lately(self, tenant: TenantId) -> bool:
        """Whether the tenant's jobs were counted again a moment ago."""
        recounted_s = self._recounted_s.get(tenant)
        return recounted_s is not None and self._now_s() < recounted_s + RECOUNT_S

    def note_crowd(self, tenant: TenantId) -> None:
        """More of the tenant's clouds come than can be taken in, or worked off."""
        self._crowded_until_s[tenant] = self._now_s() + CROWDED_S

    def require_place(self, tenant: TenantId) -> None:
        """Raises WorkersBusy where no cloud more can be taken in now."""
        if not self._has_place(tenant):
            self.note_crowd(tenant)
            message = f"{self.clouds} clouds are being taken in; try again with the same id"
            raise WorkersBusy(message, retry_after_s=BUSY_RETRY_S)

    @asynccontextmanager
    async def cloud(self, tenant: TenantId, *, patient: bool = False) -> AsyncIterator[Callable[[int], None]]:
        """A place for one cloud, until it is stored; call what is given with its points once it is decoded.

        It is paid for in advance, with as many points as the last one of the tenant had: else all that come before its
        points are counted would find some left. Raises WorkersBusy where all places, or the tenant's share of them, are
        taken. A cloud that is `patient` waits for its turn: that of a stream, of which there are few, and which holds
        back its client.
        """
        if patient and not self._has_place(tenant):
            await self._turn(tenant)
        else:
            self.require_place(tenant)
            self._enter(tenant)
        place = _Place(tenant, self._last_points.get(tenant, 0))
        self.spend(tenant, place.expected)
        try:
            yield partial(self._count, place)
        finally:
            if not place.settled:
                self._settle(place, 0)
            self._leave(tenant)

    @contextmanager
    def stream(self, tenant: TenantId, *, replaces: bool) -> Iterator[None]:
        """A place for one stream; one that `replaces` another, which ends, gets that one's.

        Raises RateLimited where the client or the service has enough of them.
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

    def _has_place(self, tenant: TenantId) -> bool:
        share = max(1, int(self.limits.clouds * self.limits.tenant_share))
        if self.clouds >= self.limits.clouds or self._clouds[tenant] >= share:
            return False
        crowded = self._now_s() < self._crowded_until_s.get(tenant, 0.0)
        return not crowded or self._undecoded[tenant] < DECODERS

    async def _turn(self, tenant: TenantId) -> None:
        """Wait for a place; it is taken when this returns."""
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
        self._clouds[tenant] += 1
        self._undecoded[tenant] += 1

    def _count(self, place: _Place, points: int) -> None:
        """The cloud is decoded and has so many points: as many are expected of the next one."""
        self._last_points[place.tenant] = points
        self._settle(place, points)

    def _settle(self, place: _Place, points: int) -> None:
        """Pay for what the cloud has brought, no more and no less; another one may wait for a decoder."""
        place.settled = True
        self._pay(place.tenant, points - place.expected)
        self._undecoded[place.tenant] -= 1
        self._wake()

    def _leave(self, tenant: TenantId) -> None:
        self._clouds[tenant] -= 1
        self._wake()

    def _wake(self) -> None:
        """Give each place that is free to whoever waits for it longest."""
        for waiter in tuple(self._waiters):
            if self._has_place(waiter.tenant):
                self._waiters.remove(waiter)
                self._enter(waiter.tenant)
                waiter.turn.set_result(None)

    def _pay(self, tenant: TenantId, points: int) -> None:
        now_s = self._now_s()
        for bucket in self._buckets_of(tenant):
            bucket.take(points, now_s)

    def _buckets_of(self, tenant: TenantId) -> tuple[Bucket, ...]:
        """Of the service, the tenant and the client. There are as many as credentials, no client can make more."""
        limits = self.limits
        rates = {
            (): limits.points_per_s,
            (tenant,): limits.tenant_points_per_s,
            (tenant, self._client()): limits.client_points_per_s,
        }
        return tuple(self._bucket(key, per_s) for key, per_s in rates.items())

    def _bucket(self, key: tuple[str, ...], per_s: float) -> Bucket:
        if key not in self._buckets:
            most = per_s * self.limits.burst_s
            self._buckets[key] = Bucket(per_s, most, most, self._now_s())
        return self._buckets[key]
