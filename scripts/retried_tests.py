"""Tests that continuous integration tried again: their names are a file of the run, compared with the run before.

    python scripts/retried_tests.py note LOG KEPT      names of one to three failed tests of a log, written to KEPT
    python scripts/retried_tests.py compare KEPT       exit status 1 where the run before on this machine has one, too

The names of the last run on this machine are in ${XDG_CACHE_HOME:-~/.cache}/revisit-ci/retried-tests.txt, outside the
clone, which is new for every run. A machine that keeps no such folder has no run before: nothing is compared there.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

MOST = 3
"""More failures than these are no accident: none is tried again."""

FAILED = re.compile(r"^(?:FAILED|ERROR) (tests/[^\[\n]*?(?:\[.*?\])?)(?: - .*)?$", re.MULTILINE)
"""A line of pytest's summary: what comes before the message is the name, whose brackets may hold " - ", too."""


def repeated(names: list[str], last_run: Path) -> list[str]:
    """The names that `last_run` has too; afterwards it holds `names`."""
    try:
        last_run.parent.mkdir(parents=True, exist_ok=True)
        before = set(last_run.read_text().splitlines()) if last_run.exists() else set()
        last_run.write_text("".join(f"{name}\n" for name in names))
    except OSError as error:
        print(f"the names of retried tests cannot be kept for the next run: {error}")
        return []
    return [name for name in names if name in before]


def note(log: Path, kept: Path) -> int:
    """Write the names of the failed tests to `kept`; 1 where there are none, or too many to try again."""
    names = FAILED.findall(log.read_text())
    if not 1 <= len(names) <= MOST:
        return 1
    kept.write_text("".join(f"{name}\n" for name in names))
    return 0


def compare(kept: Path) -> int:
    """Print the names of this run; 1 where one of them was retried in the run before, too."""
    names = kept.read_text().splitlines()
    print(f"== tests tried again in this run: {len(names)} ==", *names, sep="\n")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    again = repeated(names, cache / "revisit-ci" / "retried-tests.txt")
    for name in again:
        print(f"retried twice in a row: {name}\n  Repair the race in it, or in the product; a second try hides it.")
    return int(bool(again))


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["note", log, kept]:
            sys.exit(note(Path(log), Path(kept)))
        case ["compare", kept]:
            sys.exit(compare(Path(kept)))
        case _:
            sys.exit(__doc__)
