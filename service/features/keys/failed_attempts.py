"""The rate limit of failed authentications."""

from __future__ import annotations

from collections.abc import Callable

from revisit.service.capacity.budget import Rate, RateBudget


class FailedAttempts:
    """A budget per address (20, then one in 5 s) and for all together (200, then one a second).

    A valid credential is never refused for it: a client that shares an address with an attacker stays in.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        """`now_s` is a monotonic clock, seconds."""
        self._rates = RateBudget(now_s)
        self._over_budget = 0

    def count(self, address: str) -> float:
        """Count a failure; 0 within the budget, else the seconds until it has room."""
        wait_s = self._rates.try_take([Rate((address,), 0.2, 20.0), Rate((), 1.0, 200.0)])
        self._over_budget += wait_s > 0.0
        return wait_s

    def take_over_budget(self) -> int:
        """How many failures were over budget since this was asked last."""
        count, self._over_budget = self._over_budget, 0
        return count
