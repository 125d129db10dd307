"""A clock that moves when it is told to."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass
class SteppedClock:
    """`MachineClock`; the time of day follows `ms` unless `day_ns` says it."""

    boot_id: str = "boot-1"
    ms: int = 1_000_000
    day_ns: int | None = None

    def wall_ns(self) -> int:
        """See `Clock`."""
        return 1_700_000_000_000_000_000 + self.ms * 1_000_000 if self.day_ns is None else self.day_ns

    def monotonic_ms(self) -> int:
        """See `Clock`."""
        return self.ms

    def sleep(self, duration_s: float) -> None:
        """See `Clock`: takes its time, and moves no clock."""
        time.sleep(duration_s)


@dataclass
class PassingClock(SteppedClock):
    """Sleeping takes no time, and moves the clock: for a world in which only one thread works."""

    def sleep(self, duration_s: float) -> None:
        """See `Clock`."""
        self.ms += round(1000 * duration_s)
