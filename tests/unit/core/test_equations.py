"""Each equation of the paper is found by one search."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import revisit.core

SOURCES = [path.read_text() for path in Path(str(revisit.core.__file__)).parent.rglob("*.py")]


@pytest.mark.parametrize("number", range(1, 16))
def test_the_line_of_each_equation_names_it(number):
    assert any(re.search(rf"  # Eq\. {number}\b", source) for source in SOURCES)
