"""The rate limit of failed authentications."""

from __future__ import annotations

from collections import OrderedDict

from revisit.service.capacity.in_flight import TokenBucket

ADDRESSES = 4096
"""Addresses remembered; the one that failed longest ago is forgotten first."""


class FailedAttempts:
    """A budget per address (20, then one in 5 s) and for all together (200, then one a second).

    A valid credential is never refused for it: a client that shares an address with an attacker stays in.
    """

    def __init__(self) -> None:
        self._all: TokenBucket | None = None
        self._by_address: OrderedDict[str, TokenBucket] = OrderedDict()
        self._over_budget = 0

    def count(self, address: str, now_s: float) -> float:
        """Count a failure at `now_s` of a monotonic clock; 0 within the budget, else the seconds until it has room."""
        self._all = self._all or TokenBucket.full(1.0, 200.0, now_s)
        own = self._by_address.setdefault(address, TokenBucket.full(0.2, 20.0, now_s))
        self._by_address.move_to_end(address)
        if len(self._by_address) > ADDRESSES:
            self._by_address.popitem(last=False)
        wait_s = max(own.wait_s(now_s, needed=1.0), self._all.wait_s(now_s, needed=1.0))
        if wait_s > 0.0:
            self._over_budget += 1
            return wait_s
        own.take(1.0, now_s)
        self._all.take(1.0, now_s)
        return 0.0

    def take_over_budget(self) -> int:
        """How many failures were over budget since this was asked last."""
        count, self._over_budget = self._over_budget, 0
        return count
