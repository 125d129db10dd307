"""A disk that fails, is full or slow under the real service: faulty_disk.c, compiled here and preloaded there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Any

from tests.faults.preloaded import compiled, launcher
from tests.support.processes import ServiceProcess


class Trouble(StrEnum):
    """Of a disk: one in 20 calls fails, no write finds room, or syncs take 0.3 s."""

    FAILING = ""
    FULL = "full"
    SLOW = "slow"


class FaultyDisk:
    """Writes and syncs of files below `below` have a trouble, within `failing`; seeded."""

    def __init__(self, below: Path, folder: Path, seed: int) -> None:
        """The library and the list of failures are kept in `folder`. Raises CalledProcessError if cc does."""
        self._switch, self._log = folder / "failing", folder / "failures"
        self.library = compiled("faulty_disk", folder)
        self.variables = {
            "FAULTY_DISK_BELOW": str(below),
            "FAULTY_DISK_SWITCH": str(self._switch),
            "FAULTY_DISK_LOG": str(self._log),
            "FAULTY_DISK_SEED": str(seed),
        }

    @contextmanager
    def failing(self, how: Trouble = Trouble.FAILING) -> Iterator[None]:
        """The disk has this trouble within the block."""
        self._switch.write_text(how)
        try:
            yield
        finally:
            self._switch.unlink()

    def failures(self) -> Counter[str]:
        """How many calls failed so far: of `sync` and of `write`."""
        lines = self._log.read_text().splitlines() if self._log.exists() else []
        return Counter(line.split()[0] for line in lines)


class OnFaultyDisk(ServiceProcess):
    """The service with the library preloaded."""

    def __init__(self, home: Path, disk: FaultyDisk, **settings: Any) -> None:
        self.launcher = launcher(disk)
        super().__init__(home, **settings)
