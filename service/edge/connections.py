"""Unauthenticated connections, bounded by their source address.

Bounded in how many there are at the same time, and in how many begin a second: a connection that asks for one thing
costs more than a millisecond, and thousands a second leave no time for others.
"""

from __future__ import annotations

import hashlib
import itertools
import secrets
import time
from collections.abc import Callable
from enum import StrEnum

from revisit.service.capacity.addresses import holder_of, network_of
from revisit.service.capacity.budget import Rate, RateBudget, Remembered
from revisit.service.capacity.limits import (
    KNOWN_S,
    UNAUTHENTICATED_PER_ADDRESS,
    ArrivalRates,
)

Leave = Callable[[], None]
"""Ends a connection."""


class Shown(StrEnum):
    """A connection's credentials so far."""

    NOTHING = "nothing"
    READINESS = "readiness"
    """It asks whether the service is ready."""
    UNKNOWN = "unknown"
    """A credential that is not known, or nothing that can be read."""


class UnauthenticatedConnections:
    """Counts and paces. One too many of an address closes the oldest unauthenticated one of that address.

    All calls come from the event loop.
    """

    def __init__(
        self,
        most: int = UNAUTHENTICATED_PER_ADDRESS,
        rates: ArrivalRates = ArrivalRates(),
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """`most` of each address; `now_s` is a monotonic clock, seconds."""
        self._most = most
        self._rates = rates
        self._now_s = now_s
        self._numbers = itertools.count()
        self._by_holder: dict[str, dict[int, Leave]] = {}
        self._budget = RateBudget(now_s)
        self._known: Remembered[bytes, float] = Remembered()
        self._secret = secrets.token_bytes(16)

    def may_begin(self, address: str, shown: Shown = Shown.NOTHING) -> bool:
        """Whether a connection from an address may begin now; then it counts, until it is vouched for.

        Connections with and without credentials have each a pace of their own.
        """
        return self._budget.try_take(self._rates_of(address, shown)) == 0.0

    def vouch(self, address: str, credential: str | None, shown: Shown | None = Shown.NOTHING) -> None:
        """Somebody was admitted over a connection that began: it does not count, and the credential is known.

        `shown` is None where it did not count. Of one credential, so many connections do not count.
        """
        if shown is not None and (credential is None or self.may_return(credential)):
            self._budget.take(self._rates_of(address, shown), -1.0)
        if credential is not None:
            self._known[self._digest(credential)] = self._now_s()

    def is_known(self, credential: str) -> bool:
        """Whether somebody was admitted with this credential of late."""
        return self._known.get(self._digest(credential), -KNOWN_S) + KNOWN_S > self._now_s()

    def may_return(self, credential: str) -> bool:
        """Whether one more connection of a credential may begin for its own sake; then it counts for it."""
        rate = self._rate(("client", self._digest(credential).hex()), self._rates.client_per_s)
        return self._budget.try_take([rate]) == 0.0

    def _rates_of(self, address: str, shown: Shown) -> list[Rate]:
        rates = self._rates
        per_s = rates.unknown_per_s if shown is Shown.UNKNOWN else rates.anonymous_per_s
        of = {
            (shown, "address", holder_of(address)): per_s,
            (shown, "network", network_of(address)): per_s * rates.network_times,
            (shown, "all"): per_s * rates.all_times,
        }
        return [self._rate(holder, rate) for holder, rate in of.items()]

    def _rate(self, holder: tuple[str, ...], per_s: float) -> Rate:
        return Rate(holder, per_s, per_s * self._rates.burst_s)

    def _digest(self, credential: str) -> bytes:
        return hashlib.blake2b(credential.encode(), digest_size=16, key=self._secret).digest()

    def arrive(self, address: str, leave: Leave) -> Callable[[], None]:
        """Count one more; returns the function to call, once or more, when it is authenticated or closed."""
        holder, number = holder_of(address), next(self._numbers)
        here = self._by_holder.setdefault(holder, {})
        here[number] = leave
        if len(here) > self._most:
            here.pop(next(iter(here)))()
        return lambda: self._settle(holder, number)

    def of(self, address: str) -> int:
        """The number of unauthenticated connections of this address."""
        return len(self._by_holder.get(holder_of(address), ()))

    def _settle(self, holder: str, number: int) -> None:
        here = self._by_holder.get(holder, {})
        here.pop(number, None)
        if not here:
            self._by_holder.pop(holder, None)
