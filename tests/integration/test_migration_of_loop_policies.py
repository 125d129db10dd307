"""A map's loop policy comes and goes with its migration."""

from __future__ import annotations

import pytest

from revisit.service.adapters.sqlite.migration import migrate
from tests.support.stored_rows import columns, run


@pytest.fixture
def database(tmp_path):
    migrate(tmp_path / "old.db", "0007")
    run(
        tmp_path / "old.db",
        "INSERT INTO maps (tenant, map_id, content_hash, display_name, created_at_ns) VALUES ('t', 'm', 'h', '', 7)",
    )
    return tmp_path / "old.db"


def test_maps_of_before_follow_the_service(database):
    migrate(database)
    rules = run(database, "SELECT loop_candidates, min_score, min_overlap, max_seen_through FROM maps")
    assert rules == [(None, None, None, None)]
    migrate(database, "0007")
    assert "min_score" not in columns(database, "maps")


def test_a_map_with_rules_of_its_own_is_not_given_those_of_the_service_by_going_back(database):
    migrate(database)
    run(database, "UPDATE maps SET min_overlap = 0.4")
    with pytest.raises(RuntimeError, match="1 maps have a loop policy"):
        migrate(database, "0007")
    assert run(database, "SELECT min_overlap FROM maps") == [(0.4,)]
