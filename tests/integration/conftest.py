"""Every test runs on SQLite with each change; on the other stores of rows, those that are about stores.

Tests of the page share a browser.
"""

from __future__ import annotations

import pytest

from tests.support.browser import browser

OTHERS = {"memory", "postgres"}
ABOUT_STORES = {
    "test_blob_races.py", "test_large_numbers.py", "test_loops_are_told.py", "test_numbers_of_a_map.py",
    "test_scans_together.py", "test_two_hosts.py",
}  # fmt: skip
QUICK_ON_POSTGRES = {
    "test_a_session_that_the_map_does_not_rest_on_goes_after_its_days",
    "test_scans_go_so_many_hours_after_their_submap_was_described",
}
"""Retention removes rows by statements of its own: once on PostgreSQL, too."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Memory and PostgreSQL do what SQLite does, as the tests of `tests/contract` show: the rest is for slow runs."""
    for item in items:
        if isinstance(item, pytest.Function) and _repeats(item):
            item.add_marker(pytest.mark.slow)


def _repeats(item: pytest.Function) -> bool:
    """Whether this is a test of the service that runs on SQLite beside."""
    if (
        not item.nodeid.startswith("tests/integration/")
        or item.path.name in ABOUT_STORES
        or not hasattr(item, "callspec")
    ):
        return False
    on = OTHERS.intersection(item.callspec.id.split("-"))
    return bool(on) and not (on == {"postgres"} and item.originalname in QUICK_ON_POSTGRES)


@pytest.fixture(scope="module")
def chromium():
    """The browser that a file of tests of the page opens its pages in."""
    with browser() as opened:
        yield opened
