"""The rate limit of failed authentications."""

from __future__ import annotations

from collections.abc import Callable

from revisit.service.capacity.addresses import holder_of
from revisit.service.capacity.budget import Rate, RateBudget
from revisit.service.capacity.limits import (
    ADDRESS_FAILURES_AT_ONCE,
    ADDRESS_FAILURES_PER_S,
    FAILURES_AT_ONCE,
    FAILURES_PER_S,
)


class FailedAttempts:
    """A budget per address, or per network of IPv6 addresses, and one for all together.

    A valid credential is never refused for it: a client that shares an address with an attacker stays in.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        """`now_s` is a monotonic clock, seconds."""
        self._rates = RateBudget(now_s)
        self._over_budget = 0

    def count(self, address: str) -> float:
        """Count a failure; 0 within the budget, else the seconds until it has room."""
        own = Rate((holder_of(address),), ADDRESS_FAILURES_PER_S, ADDRESS_FAILURES_AT_ONCE)
        wait_s = self._rates.try_take([own, Rate((), FAILURES_PER_S, FAILURES_AT_ONCE)])
        self._over_budget += wait_s > 0.0
        return wait_s

    def take_over_budget(self) -> int:
        """How many failures were over budget since this was asked last."""
        count, self._over_budget = self._over_budget, 0
        return count
