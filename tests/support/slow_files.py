"""Files whose tests are all slow: they say so at their top, or are the lab's.

The lab is no part of the product: its tests run with `make test-all`, but for two files. `test_commands` shows that
each command of the lab starts; `test_repeating_worlds` that no pair of places that repeat is accepted with a wrong
pose.
"""

from __future__ import annotations

import re
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
LAB = TESTS / "unit/lab"
WITH_EVERY_CHANGE = {"test_commands", "test_repeating_worlds"}

_SAYS_SO = re.compile(r"^pytestmark = \[?\s*pytest\.mark\.slow\b", re.MULTILINE)


def of_the_lab(file: Path) -> bool:
    """Whether the tests of this file are slow because they are the lab's."""
    return file.parent == LAB and file.stem not in WITH_EVERY_CHANGE


def is_wholly_slow(file: Path) -> bool:
    """Whether no test of this file runs where slow ones are left out."""
    return of_the_lab(file) or _SAYS_SO.search(file.read_text()) is not None


def slow_files() -> list[Path]:
    """All of them."""
    return [file for file in sorted(TESTS.rglob("test_*.py")) if is_wholly_slow(file)]
