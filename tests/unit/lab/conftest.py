"""Marks the tests of this folder that no change of the product needs."""

from __future__ import annotations

import pytest

from tests.support.slow_files import of_the_lab


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Those of all files but two are slow."""
    for item in items:
        if item.nodeid.startswith("tests/unit/lab/") and of_the_lab(item.path):
            item.add_marker(pytest.mark.slow)
