"""Time, as the use cases see it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Instant:
    """A moment on the monotonic clock: `ms` counts within one `epoch` (boot); other epochs are always in the past."""

    epoch: str
    ms: int


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

    def instant(self) -> Instant:
        """Now, the same for all processes of this machine."""
        ...
