"""A disk that fails now and then under the real service: faulty_disk.c, compiled here and preloaded there."""

from __future__ import annotations

import shutil
import subprocess
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.support.processes import ServiceProcess

SOURCE = Path(__file__).with_name("faulty_disk.c")
COMPILER = shutil.which("cc")


class FaultyDisk:
    """One in 20 writes and one in 20 syncs of files below `below` fail, within `failing`; seeded."""

    def __init__(self, below: Path, workplace: Path, seed: int) -> None:
        """The library and the list of failures are kept in `workplace`. Raises CalledProcessError if cc does."""
        library = workplace / "faulty_disk.so"
        self._switch, self._log = workplace / "failing", workplace / "failures"
        options = ("-shared", "-fPIC", "-O2", "-Wall", "-Wextra", "-Werror", "-D_GNU_SOURCE")
        subprocess.run([str(COMPILER), *options, "-o", str(library), str(SOURCE)], check=True)
        self.launcher = (
            "env",
            f"LD_PRELOAD={library}",
            f"FAULTY_DISK_BELOW={below}",
            f"FAULTY_DISK_SWITCH={self._switch}",
            f"FAULTY_DISK_LOG={self._log}",
            f"FAULTY_DISK_SEED={seed}",
        )

    @contextmanager
    def failing(self) -> Iterator[None]:
        """The disk fails within the block."""
        self._switch.touch()
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
        self.launcher = disk.launcher
        super().__init__(home, **settings)
