"""The gap of a map, once a number of submaps, becomes the distance that comes to the same way, and back."""

from __future__ import annotations

import asyncio

import pytest

from revisit.service.adapters.sqlite.migration import migrate
from revisit.service.application.catalogue.maps import CreateMap
from tests.support.service_world import TENANT, sqlite_world
from tests.support.stored_rows import columns, run


@pytest.fixture
def database(tmp_path):
    """A store of the revision before, with maps that have the usual gap, one of their own, and their own stride."""
    world = sqlite_world(tmp_path)
    for name, stride_m in (("usual", None), ("own", None), ("long", 10.0)):
        asyncio.run(world.use_cases.maps.create(TENANT, CreateMap(name, stride_m=stride_m)))
    world.context.transactions.close()
    migrate(tmp_path / "revisit.db", "0019")
    run(tmp_path / "revisit.db", "UPDATE maps SET min_index_gap = 30 WHERE map_id != 'usual'")
    return tmp_path / "revisit.db"


def test_a_gap_becomes_a_distance_and_a_gap_again(database):
    assert "leave_distance_m" not in columns(database, "maps")
    migrate(database)
    assert run(database, "SELECT leave_distance_m FROM maps ORDER BY number") == [(None,), (3.0,), (6.0,)]
    migrate(database, "0019")
    assert run(database, "SELECT min_index_gap FROM maps ORDER BY number") == [(None,), (30,), (30,)]


def test_a_map_of_before_is_created_again_as_then_and_read(database, tmp_path):
    world = sqlite_world(tmp_path)
    again = asyncio.run(world.use_cases.maps.create(TENANT, CreateMap("usual")))
    own = asyncio.run(world.use_cases.maps.get(TENANT, "own"))
    world.context.transactions.close()
    assert again.replay and own.leave_distance_m == pytest.approx(3.0)
