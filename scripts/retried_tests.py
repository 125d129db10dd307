"""Tests that continuous integration tries again: the names of one to three failed tests of a log, written to a file.

    python scripts/retried_tests.py LOG KEPT      exit status 1 where none failed, or too many to try again

The file is what a run leaves of them. Runs are not compared: nothing that a run writes is there in the next one.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

MOST = 3
"""More failures than these are no accident: none is tried again."""

FAILED = re.compile(r"^(?:FAILED|ERROR) (tests/[^\[\n]*?(?:\[.*?\])?)(?: - .*)?$", re.MULTILINE)
"""A line of pytest's summary: what comes before the message is the name, whose brackets may hold " - ", too."""


def note(log: Path, kept: Path) -> int:
    """Write the names of the failed tests to `kept`; 1 where there are none, or too many to try again."""
    names = FAILED.findall(log.read_text())
    if not 1 <= len(names) <= MOST:
        return 1
    kept.write_text("".join(f"{name}\n" for name in names))
    return 0


if __name__ == "__main__":
    _, log, kept = sys.argv
    sys.exit(note(Path(log), Path(kept)))
