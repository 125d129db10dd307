"""The lock by which the processes of the service take turns to write."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from revisit.service.adapters.files.durable_files import open_lock, try_lock
from revisit.service.application.contract.errors import StorageUncertain

LOCK_TIMEOUT_S = 5.0


class WriterLock:
    """A lock between processes that a writer holds for each transaction, its checkpoint included.

    SQLite's own lock lets one connection write while another checkpoints, which is how SQLite before 3.51.3 can damage
    its write-ahead log; and SQLite waits for it in ever longer sleeps. The kernel releases this lock when its process
    ends, however it ends. Waiting is fair: the first in line holds the turn lock, so a busy process cannot take the
    writer lock twice while another waits.
    """

    def __init__(self, database: Path) -> None:
        """The lock files lie beside `database`."""
        self._writer = open_lock(database.with_name(f"{database.name}.writer"))
        self._turn = open_lock(database.with_name(f"{database.name}.turn"))

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the lock. Raises StorageUncertain after 5 s, with nothing written."""
        deadline = time.monotonic() + LOCK_TIMEOUT_S
        with ExitStack() as holding:
            with _locked(self._turn, deadline):
                holding.enter_context(_locked(self._writer, deadline))
            yield

    def close(self) -> None:
        """Close the files."""
        os.close(self._writer)
        os.close(self._turn)


@contextmanager
def _locked(descriptor: int, deadline: float) -> Iterator[None]:
    """Hold one `flock`. Raises StorageUncertain at `deadline` of the monotonic clock."""
    while not try_lock(descriptor):
        if time.monotonic() > deadline:
            raise StorageUncertain("another process holds the database; nothing was stored")
        time.sleep(0.001)
    try:
        yield
    finally:
        fcntl.flock(descriptor, fcntl.LOCK_UN)
