"""Commands write no file in place: a killed one leaves no half file under the name that was asked for."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3] / "revisit"
BY_ITSELF = {
    "cli/demo/own_service.py",  # a log
    "formats/whole_files.py",
    "formats/map_file.py",  # within written_beside
    "sdk/map_downloads.py",  # appended to a part
}
IN_PLACE = re.compile(r"\.write_(text|bytes)\(|open\(\"[wxa]b?\"")


@pytest.mark.parametrize("folder", ["cli", "formats", "sdk"])
def test_no_file_is_written_in_place(folder):
    found = {
        file.relative_to(ROOT).as_posix() for file in (ROOT / folder).rglob("*.py") if IN_PLACE.search(file.read_text())
    }
    assert found <= BY_ITSELF
