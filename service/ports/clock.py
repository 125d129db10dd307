"""Time, as the use cases see it."""

from __future__ import annotations

from typing import Protocol


class Clock(Protocol):
    """Time of this process. Wall time labels things, durations are measured by the monotonic clock.

    Leases and ages of rows are told by the store's own clock, which no use case sees.
    """

    def wall_ns(self) -> int:
        """Nanoseconds since 1970, UTC."""
        ...

    def monotonic_ms(self) -> int:
        """Milliseconds of a clock that is never set."""
        ...

    def sleep(self, duration_s: float) -> None:
        """Block this thread for so many seconds."""
        ...
