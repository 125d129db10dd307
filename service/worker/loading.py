"""Log lines while a worker loads: the first worker of an installation compiles its kernels."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from revisit.api.words import KERNELS

FIRST_S = 2.0
EVERY_S = 10.0


@contextmanager
def logged_while_loading(
    tell: Callable[..., Any], *, first_s: float = FIRST_S, every_s: float = EVERY_S
) -> Iterator[None]:
    """Call `tell` with `worker_still_loading` after `first_s` and then every `every_s`, until the loading ends."""
    ended, began_s = threading.Event(), time.monotonic()

    def watch() -> None:
        wait_s = first_s
        while not ended.wait(wait_s):
            tell("worker_still_loading", seconds=round(time.monotonic() - began_s, 1), hint=KERNELS)
            wait_s = every_s

    thread = threading.Thread(target=watch, name="loading", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
