"""Time as the machine tells it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Protocol

from revisit.service.ports.clock import Clock

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class MachineClock(Clock, Protocol):
    """A clock of one boot of a machine: its monotonic time begins anew with each."""

    @property
    def boot_id(self) -> str:
        """The same for all processes of this boot, another one for every other boot and machine."""
        ...


class SystemClock:
    """`MachineClock`: all processes of one boot share the monotonic clock."""

    def __init__(self) -> None:
        """Reads the boot's id once; where there is none, all boots count as one."""
        self.boot_id = _BOOT_ID.read_text().strip() if _BOOT_ID.exists() else "this-boot"

    def wall_ns(self) -> int:
        """See `Clock`."""
        return time.time_ns()

    def monotonic_ms(self) -> int:
        """See `Clock`."""
        return time.monotonic_ns() // 1_000_000

    def sleep(self, duration_s: float) -> None:
        """See `Clock`."""
        time.sleep(duration_s)
