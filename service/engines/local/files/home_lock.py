"""One gateway for a data folder: a lock that the kernel takes back when its process ends, however it ends."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from revisit.service.engines.local.files.disk import open_lock, try_lock

LOCK = "gateway.lock"


class HomeTaken(Exception):
    """Another gateway serves the data folder."""


@contextmanager
def sole_gateway(home: Path) -> Iterator[None]:
    """Hold the data folder for this process. Raises HomeTaken where another gateway has it."""
    home.mkdir(parents=True, exist_ok=True, mode=0o700)
    descriptor = open_lock(home / LOCK)
    try:
        if not try_lock(descriptor):
            holder = os.pread(descriptor, 20, 0).decode("ascii", "replace").strip()
            raise HomeTaken(f"the data folder {home} is served by another gateway (process {holder or 'unknown'})")
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        os.close(descriptor)
