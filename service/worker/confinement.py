"""Bounds of a worker's memory and priority, so that a greedy job harms nobody but itself."""

from __future__ import annotations

import os
import resource
from contextlib import suppress
from pathlib import Path

SACRIFICE = 500
"""Of -1000 to 1000: where memory runs out all the same, the kernel ends a worker before it ends the gateway."""


NICENESS = 5
"""Of -20 to 19: where all cores are busy with descriptions, the gateway goes first, since somebody waits for it.

Not more: a worker also holds the lock of the writers for a moment.
"""


def confine(memory_bytes: int) -> None:
    """Bound this process's own memory: more is a MemoryError, or the end of this process alone.

    It yields to the gateway where they compete for a core.

    Only memory that the process may write to counts (RLIMIT_DATA). The address space is no measure: torch and Open3D
    reserve twice as much as they use. A core dump would write a customer's site to the disk, so there is none.
    """
    os.setpriority(os.PRIO_PROCESS, 0, max(NICENESS, os.getpriority(os.PRIO_PROCESS, 0)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = memory_bytes if hard == resource.RLIM_INFINITY else min(memory_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
    # A container may forbid it; the limit above holds without.
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(SACRIFICE))


def resident_bytes() -> int:
    """The private memory of this process now, without shared pages such as mapped files."""
    held, shared = Path("/proc/self/statm").read_text().split()[1:3]
    return (int(held) - int(shared)) * resource.getpagesize()
