"""Budgets of the service: rates by token buckets, amounts in use, and one line of those that wait for room.

`RateBudget` bounds a rate: points, calls or connections a second. `Budget` bounds an amount in use: clouds, bytes or
work. Both count by holder: the service, a tenant, a client, an address. The limits themselves, the errors beyond them
and the shares of holders beside others are those of their users in this package. All calls come from the event loop.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")

MOST_HOLDERS = 4096
"""Holders that are remembered at the same time, where clients may choose any number of them."""


class Remembered(dict[K, V]):
    """Values by key, at most `most`; the one that was set longest ago is forgotten first."""

    def __init__(self, most: float = MOST_HOLDERS) -> None:
        super().__init__()
        self.most = most

    def __setitem__(self, key: K, value: V) -> None:
        """Set a value, which is now the last to be forgotten."""
        self.pop(key, None)
        super().__setitem__(key, value)
        if len(self) > self.most:
            del self[next(iter(self))]


@dataclass
class TokenBucket:
    """Refilled with `per_s` tokens a second up to `burst`; times in seconds of a monotonic clock.

    More may be taken than there is. The balance is then negative until the rate has made up for it.
    """

    per_s: float
    burst: float
    balance: float
    at_s: float

    def wait_s(self, now_s: float, needed: float) -> float:
        """Seconds until the balance is at least `needed`; 0 where it is."""
        self._refill(now_s)
        return max(0.0, (needed - self.balance) / self.per_s)

    def take(self, tokens: float, now_s: float) -> None:
        """Take tokens; a negative number gives them back."""
        self._refill(now_s)
        self.balance -= tokens

    def change(self, rate: Rate, now_s: float) -> None:
        """Refill by another rate from now on."""
        self._refill(now_s)
        self.per_s, self.burst = rate.per_s, rate.burst

    def _refill(self, now_s: float) -> None:
        self.balance = min(self.burst, self.balance + (now_s - self.at_s) * self.per_s)
        self.at_s = now_s


class GatewayShare:
    """One part in as many as there are gateways: no shared counter lies in the way of a request."""

    def __init__(self) -> None:
        """The only gateway, until told otherwise."""
        self.gateways = 1

    def of(self, limit: float) -> float:
        """The part of a rate."""
        return limit / self.gateways

    def of_whole(self, limit: int) -> int:
        """The part of a number, at least one."""
        return max(1, -(-limit // self.gateways))


class Rate(NamedTuple):
    """The rate of a holder: `per_s` tokens a second, and `burst` of them at once."""

    holder: tuple[str, ...]
    per_s: float
    burst: float


class RateBudget:
    """Token buckets by holder, full at first. A request counts for several at once: the service, a tenant, a client."""

    def __init__(self, now_s: Callable[[], float], most: float = MOST_HOLDERS) -> None:
        """`now_s` is a monotonic clock, seconds. Of more than `most` holders the least recent are forgotten."""
        self._now_s = now_s
        self._buckets: Remembered[tuple[str, ...], TokenBucket] = Remembered(most)

    def wait_s(self, rates: Sequence[Rate], needed: float = 0.0) -> float:
        """Seconds until every balance is at least `needed`; 0 where it is."""
        now_s = self._now_s()
        return max(self._bucket(rate, now_s).wait_s(now_s, needed) for rate in rates)

    def take(self, rates: Sequence[Rate], tokens: float = 1.0) -> None:
        """Take tokens of each rate, there or not; a negative number gives them back."""
        now_s = self._now_s()
        for rate in rates:
            self._bucket(rate, now_s).take(tokens, now_s)

    def try_take(self, rates: Sequence[Rate]) -> float:
        """Take a token of each rate; 0 if they were there, else the seconds until they are, and nothing is taken."""
        wait_s = self.wait_s(rates, 1.0)
        if wait_s == 0.0:
            self.take(rates)
        return wait_s

    def _bucket(self, rate: Rate, now_s: float) -> TokenBucket:
        bucket = self._buckets.get(rate.holder) or TokenBucket(rate.per_s, rate.burst, rate.burst, now_s)
        if bucket.per_s != rate.per_s:
            bucket.change(rate, now_s)
        self._buckets[rate.holder] = bucket
        return bucket


class Held(Counter[K]):
    """Amounts in use by holder; one that holds nothing takes no memory."""

    def add(self, holder: K, amount: int) -> None:
        """So much more; a negative amount is given back."""
        self[holder] += amount
        if not self[holder]:
            del self[holder]


@dataclass(eq=False)
class _Waiter:
    holder: str
    amount: int
    turn: asyncio.Future[None] = field(default_factory=lambda: asyncio.get_running_loop().create_future())


class Budget:
    """Amounts in use, and those that wait for room: the first that fits goes on."""

    def __init__(self, has_room: Callable[[str, int], bool], *, in_turns: bool = False) -> None:
        """`has_room` tells whether a holder may have so much more now. In turns, a holder that was let in goes last."""
        self.held: Held[str] = Held()
        self._has_room = has_room
        self._in_turns = in_turns
        self._waiting: list[_Waiter] = []

    @property
    def waiting(self) -> int:
        """The number of those that wait."""
        return len(self._waiting)

    def take(self, holder: str, amount: int = 1) -> None:
        """Use so much more, where there is room or not."""
        self.held.add(holder, amount)

    def give(self, holder: str, amount: int = 1) -> None:
        """Use so much less; those that wait may go on."""
        self.held.add(holder, -amount)
        self.wake()

    async def enter(self, holder: str, amount: int = 1) -> None:
        """Use so much more as soon as there is room. A caller that is cancelled uses nothing."""
        if self._has_room(holder, amount):
            self.take(holder, amount)
            return
        waiter = _Waiter(holder, amount)
        self._waiting.append(waiter)
        try:
            await waiter.turn
        except asyncio.CancelledError:
            if waiter in self._waiting:
                self._waiting.remove(waiter)
            else:
                self.give(holder, amount)
            raise

    def wake(self) -> None:
        """Let in those that fit, the longest waiting first: amounts in use, or bounds, have changed."""
        for waiter in tuple(self._waiting):
            if not waiter.turn.done() and self._has_room(waiter.holder, waiter.amount):
                self._let_in(waiter)

    def _let_in(self, waiter: _Waiter) -> None:
        self._waiting.remove(waiter)
        self.take(waiter.holder, waiter.amount)
        waiter.turn.set_result(None)
        if self._in_turns:
            self._waiting.sort(key=lambda other: other.holder == waiter.holder)


async def wait_while(
    condition: Callable[[], bool], poll_s: float, polls: int, sleep: Callable[[float], Awaitable[None]]
) -> None:
    """Return once `condition` does not hold; it is checked every `poll_s` seconds, at most `polls` times."""
    for _ in range(polls):
        if not condition():
            return
        await sleep(poll_s)
