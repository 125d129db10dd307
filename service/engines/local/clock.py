"""Time as the machine tells it."""

from __future__ import annotations

import time
from pathlib import Path

from revisit.service.ports.clock import Instant

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class SystemClock:
    """`Clock`: all processes of one boot share the monotonic clock; the boot id is the epoch."""

    def __init__(self) -> None:
        """Reads the boot's id once; where there is none, all boots count as one."""
        self._epoch = _BOOT_ID.read_text().strip() if _BOOT_ID.exists() else "this-boot"

    def wall_ns(self) -> int:
        """See `Clock`."""
        return time.time_ns()

    def instant(self) -> Instant:
        """See `Clock`."""
        return Instant(self._epoch, time.monotonic_ns() // 1_000_000)
