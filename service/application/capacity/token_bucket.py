"""A token bucket: tokens are refilled at a steady rate up to a burst."""

from __future__ import annotations

from dataclasses import dataclass


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
