"""How long tests wait: far longer than anything takes, since a limit costs nothing where what is awaited comes.

A test waits for what must happen, never for a time. How fast that was is measured against the pace of this machine,
which may be slow, or busy with other tests.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable

PATIENCE_S = float(os.environ.get("REVISIT_TEST_PATIENCE_S", "120"))
"""The limit of every wait in tests; well below pytest's own of 300 s, so that the wait says what did not happen."""

QUIET = bool(os.environ.get("REVISIT_TEST_TIMES"))
"""Whether this machine does nothing else, so that promises of time are held as they are written."""

REFERENCE = "sum(number * number for number in range(1_000_000))"
REFERENCE_S = 0.1
"""What `REFERENCE` takes in a new process on the machine that the promises were written for, when it is quiet."""

LEEWAY = 4.0
"""How many times its promise a step may take beside other work, in the pace of that work: a wait that hangs, or that
ends only with a time limit, is longer."""


def eventually(
    condition: Callable[[], object], what: str = "it did not happen", timeout_s: float = PATIENCE_S
) -> float:
    """Wait until `condition` holds; how long that took, seconds. Raises AssertionError with `what` otherwise."""
    began_s = time.monotonic()
    while not condition():
        assert time.monotonic() - began_s < timeout_s, what
        time.sleep(0.01)
    return time.monotonic() - began_s


def in_time(took_s: float, promised_s: float) -> bool:
    """Whether a promise about time is kept: as it is written on a quiet machine, in the pace of this one elsewhere."""
    if took_s <= promised_s or QUIET:
        return took_s <= promised_s
    return took_s <= LEEWAY * slowness() * promised_s


def slowness() -> float:
    """How many times longer work takes now than on the machine that the promises were written for; at least 1."""
    began_s = time.monotonic()
    subprocess.run([sys.executable, "-S", "-c", REFERENCE], check=True)
    return max(1.0, (time.monotonic() - began_s) / REFERENCE_S)
