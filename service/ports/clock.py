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
    """Time. Wall time labels things; only the monotonic clock decides anything."""

    def wall_ns(self) -> int:
        """Nanoseconds since 1970, UTC."""
        ...

    def instant(self) -> Instant:
        """Now, the same for all processes of this machine."""
        ...
