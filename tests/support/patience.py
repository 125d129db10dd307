"""How long tests wait: far longer than anything takes, since a limit costs nothing where what is awaited comes.

A test waits for what must happen, never for a time; how fast that was is asked only where a machine does nothing else.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable

PATIENCE_S = float(os.environ.get("REVISIT_TEST_PATIENCE_S", "120"))
"""The limit of every wait in tests; well below pytest's own of 300 s, so that the wait says what did not happen."""


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
    """Whether a promise about time is kept; asked only where REVISIT_TEST_TIMES says that the machine is quiet.

    On a machine that is slow or busy with other work a measured time says nothing about the service.
    """
    return took_s <= promised_s or not os.environ.get("REVISIT_TEST_TIMES")
