"""The lab is no part of the product: its tests run with `make test-all`, but for two files.

`test_commands` shows that each command of the lab starts; `test_repeating_worlds` that no pair of places that repeat is
accepted with a wrong pose.
"""

from __future__ import annotations

from pathlib import Path

import pytest

WITH_EVERY_CHANGE = {"test_commands", "test_repeating_worlds"}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of this folder that no change of the product needs."""
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent) and item.path.stem not in WITH_EVERY_CHANGE:
            item.add_marker(pytest.mark.slow)
