"""Files of slow tests alone are not collected by `make test`; all that it shows of them is that they can be."""

from __future__ import annotations

import importlib
from contextlib import suppress

import pytest

from tests.support.slow_files import TESTS, is_wholly_slow, slow_files


def test_every_file_of_slow_tests_can_be_imported():
    files = slow_files()
    assert {file.parent.name for file in files} >= {"lab", "load", "integration"}
    for file in files:
        with suppress(pytest.skip.Exception):
            importlib.import_module(".".join(file.relative_to(TESTS.parent).with_suffix("").parts))


@pytest.mark.parametrize(
    "mark", ["pytest.mark.slow", "[pytest.mark.slow, pytest.mark.timeout(9)]", "[\n    pytest.mark.slow,\n]"]
)
def test_a_file_that_marks_all_its_tests_is_wholly_slow_and_one_that_marks_some_is_not(tmp_path, mark):
    file = tmp_path / "test_a.py"
    file.write_text(f"import pytest\n\npytestmark = {mark}\n")
    assert is_wholly_slow(file)
    file.write_text("import pytest\n\n\n@pytest.mark.slow\ndef test_a():\n    pass\n")
    assert not is_wholly_slow(file)
