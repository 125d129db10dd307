"""How a worker process ended, and whether its job may have had a part in it."""

from __future__ import annotations

import signal
from enum import StrEnum
from pathlib import Path

from revisit.service.worker.heartbeat import ORPHANED, OVERTIME

STORAGE_FAILED = 74
"""Exit status after an I/O error of the storage (EX_IOERR): the fate of the last commit is unknown until a restart."""

FROM_OUTSIDE = frozenset({-signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT, -signal.SIGHUP, ORPHANED, STORAGE_FAILED})
"""Statuses of workers that somebody ended, or that found their gateway gone or their disk failing."""

KERNEL_COUNTS = Path("/proc/vmstat")


class WorkerEnd(StrEnum):
    """How a worker process ended."""

    STOPPED = "stopped"
    KILLED = "killed"
    SILENT = "silent"
    OVERTIME = "overtime"
    FAILED = "failed"


def end_of(status: int) -> WorkerEnd:
    """The end that an exit status tells of."""
    if status == 0:
        return WorkerEnd.STOPPED
    if status == OVERTIME:
        return WorkerEnd.OVERTIME
    return WorkerEnd.KILLED if status < 0 else WorkerEnd.FAILED


def is_innocent(end: WorkerEnd, status: int, out_of_memory: int) -> bool:
    """Whether the job of a worker that ended had no part in it, as far as one can tell.

    `out_of_memory`: processes that the kernel has killed for want of memory while the worker lived. One of them may
    have been the worker: its SIGKILL looks like any other.
    """
    if end is WorkerEnd.STOPPED:
        return True
    outside = end is not WorkerEnd.SILENT and status in FROM_OUTSIDE
    return outside and not (status == -signal.SIGKILL and out_of_memory)


def out_of_memory_kills(counts: Path = KERNEL_COUNTS) -> int:
    """How many processes of this machine the kernel has killed for want of memory; 0 where it does not tell."""
    try:
        lines = counts.read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("oom_kill ")), 0)


def reason_of(end: WorkerEnd, status: int) -> str:
    """Why a run did not come back, as the end of a sentence."""
    if end is WorkerEnd.SILENT:
        return "its worker hung without a sign of life"
    if status < 0:
        return f"its worker was ended by signal {-status} ({signal.strsignal(-status)})"
    return f"its worker ended with status {status}"
