"""Scale of a map and origin of a job come and go with their migration, on a database that is in use."""

from __future__ import annotations

import pytest

from revisit.service.adapters.sqlite.migration import current_revision, migrate
from revisit.service.adapters.sqlite.transactions import SqliteTransactions
from tests.contract.test_transactions import fill
from tests.support.stored_rows import columns, run


@pytest.fixture
def database(tmp_path):
    migrate(tmp_path / "old.db", "0001")
    run(
        tmp_path / "old.db",
        "INSERT INTO maps (tenant, map_id, content_hash, display_name, created_at_ns) VALUES ('t', 'm', 'h', '', 7)",
    )
    return tmp_path / "old.db"


def test_maps_of_the_first_schema_become_maps_of_street_size(database):
    migrate(database)
    store = SqliteTransactions(database, checkpoints=True)
    found = store.read(lambda uow: uow.maps.get("t", "m")).result()
    store.write(fill).result()
    store.close()
    assert (found.scene_scale, found.created_at_ns) == (1.0, 7)
    assert {"request_id", "traceparent"} <= columns(database, "jobs")
    migrate(database, "0001")
    assert current_revision(database) == "0001"
    assert "scene_scale" not in columns(database, "maps")
    assert {"request_id", "traceparent"}.isdisjoint(columns(database, "jobs"))


def test_a_map_of_another_scale_is_not_taken_for_a_street_by_going_back(database):
    migrate(database)
    run(database, "UPDATE maps SET scene_scale = 0.25")
    with pytest.raises(RuntimeError, match="1 maps have a scene_scale"):
        migrate(database, "0001")
    assert "scene_scale" in columns(database, "maps")
