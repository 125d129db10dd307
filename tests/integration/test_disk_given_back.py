"""What retention removes is off the disk, blobs and database, as `du` counts it; a store of before keeps its pages."""

from __future__ import annotations

import sqlite3
from contextlib import closing

import pytest

from revisit.service.domain.retention import parsed
from revisit.service.engines.local.files.disk import FailStop
from revisit.service.engines.local.sqlite import free_pages
from revisit.service.engines.local.sqlite.connections import write_ahead_log
from revisit.service.engines.local.sqlite.free_pages import FreePages
from revisit.service.engines.local.sqlite.transactions import StorageFailures
from tests.support.retained import DAY_MS, disk_bytes, driven, retained
from tests.support.service_world import SESSION, TENANT, sqlite_world
from tests.support.stored_rows import run

SCANS = 300


@pytest.fixture(autouse=True)
def few_kept(monkeypatch):
    """As with a database of gigabytes."""
    monkeypatch.setattr(free_pages, "KEPT_PAGES", 4)
    monkeypatch.setattr(free_pages, "PAGES_AT_ONCE", 8)


def tended(database) -> int:
    """Pages given back until there are none."""
    pages = FreePages(database, StorageFailures(write_ahead_log(database), FailStop(), lambda: None))
    given = 0
    while turn := pages.tend():
        given += turn
    run(database, "PRAGMA wal_checkpoint(TRUNCATE)")
    return given


async def test_a_run_gives_the_disk_back_as_its_dry_run_says(tmp_path):
    world = sqlite_world(tmp_path)
    await driven(world, SCANS)
    world.clock.ms += 2 * DAY_MS
    run(tmp_path / "revisit.db", "PRAGMA wal_checkpoint(TRUNCATE)")
    before, database_before = disk_bytes(tmp_path), disk_bytes_of_database(tmp_path)
    policy = "scans=none,rejected=1d"
    asked = await world.use_cases.retention.preview(TENANT, SESSION.map_id, parsed(policy))
    await retained(world, policy)
    assert tended(tmp_path / "revisit.db") > 0
    world.context.transactions.close()
    freed, told = before - disk_bytes(tmp_path), sum(one.bytes for one in asked.rules)
    assert 0.5 * told <= freed <= 1.5 * told
    assert disk_bytes_of_database(tmp_path) < 0.8 * database_before


def disk_bytes_of_database(home) -> int:
    return sum(path.lstat().st_blocks * 512 for path in home.glob("revisit.db*"))


@pytest.mark.slow
async def test_a_database_whose_pages_were_given_back_is_whole(tmp_path):
    world = sqlite_world(tmp_path)
    await driven(world, SCANS)
    world.clock.ms += 2 * DAY_MS
    await retained(world, "scans=none,rejected=1d")
    assert tended(tmp_path / "revisit.db") > 0
    await driven(world, 30, type(SESSION)("town", "tuesday"))
    assert run(tmp_path / "revisit.db", "PRAGMA integrity_check") == [("ok",)]
    assert len(run(tmp_path / "revisit.db", "SELECT number FROM scans WHERE session_id = 'tuesday'")) == 30
    world.context.transactions.close()


def test_a_file_of_before_keeps_its_pages(tmp_path):
    database = tmp_path / "revisit.db"
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("PRAGMA journal_mode=wal")
        connection.execute("CREATE TABLE rows (content TEXT)")
        connection.executemany("INSERT INTO rows VALUES (?)", [("x" * 4000,)] * 100)
        connection.execute("DELETE FROM rows")
        connection.commit()
    assert tended(database) == 0
