"""How many failed authentications are answered and written down one by one."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

ADDRESSES = 4096
"""Addresses remembered; the one that failed longest ago is forgotten first."""


@dataclass
class Bucket:
    """Holds up to `burst` tokens, refilled at `per_s` a second; times in milliseconds of a monotonic clock."""

    burst: float
    per_s: float
    tokens: float
    at_ms: int

    def wait_s(self, now_ms: int) -> float:
        """How long until there is a token, seconds; 0 where there is one."""
        self.tokens = min(self.burst, self.tokens + (now_ms - self.at_ms) / 1000 * self.per_s)
        self.at_ms = now_ms
        return max(0.0, (1.0 - self.tokens) / self.per_s)


class FailedAttempts:
    """A budget per address (20, then one in 5 s) and for all together (200, then one a second).

    A valid credential is never refused for it: whoever shares an address with an attacker stays in.
    """

    def __init__(self) -> None:
        self._all: Bucket | None = None
        self._by_address: OrderedDict[str, Bucket] = OrderedDict()
        self._over_budget = 0

    def count(self, address: str, now_ms: int) -> float:
        """Count a failure; 0 where the budget had room for it, else the seconds until it has again."""
        self._all = self._all or Bucket(200.0, 1.0, 200.0, now_ms)
        own = self._by_address.setdefault(address, Bucket(20.0, 0.2, 20.0, now_ms))
        self._by_address.move_to_end(address)
        if len(self._by_address) > ADDRESSES:
            self._by_address.popitem(last=False)
        wait_s = max(own.wait_s(now_ms), self._all.wait_s(now_ms))
        if wait_s > 0.0:
            self._over_budget += 1
            return wait_s
        own.tokens -= 1.0
        self._all.tokens -= 1.0
        return 0.0

    def take_over_budget(self) -> int:
        """How many failures were over budget since this was asked last."""
        count, self._over_budget = self._over_budget, 0
        return count
