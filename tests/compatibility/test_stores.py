"""A store that an earlier version has left is opened by this one, and holds what was acknowledged then (P27)."""

from __future__ import annotations

import asyncio
import hashlib
import re
import sqlite3
import zipfile
from contextlib import closing
from pathlib import Path

import pytest

from revisit.service.domain.events import EventRecord
from revisit.service.domain.identity import DEFAULT_TENANT, SubmapKey
from revisit.service.engines import schema
from revisit.service.engines.local.sqlite.migration import current_revision, migrate
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.engines.schema import NEWEST_REVISION, ForeignSchema
from revisit.service.features.index.answers import SearchCriteria
from tests.compatibility.write import ROOT, STORES, write_store
from tests.faults.drive import POSTED, undisturbed
from tests.faults.history import History
from tests.faults.survey import survey
from tests.support.next_migration import NEXT_REVISION, migrations_with_a_next_step
from tests.support.service_world import TENANT, sqlite_world

STATES = {"DESCRIBED": 8, "FAILED": 1}


def unpacked(file: Path, folder: Path) -> Path:
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder)
    return folder / "home"


@pytest.fixture(params=[file.name for file in sorted(STORES.glob("*.zip"))])
def home(request, tmp_path):
    return unpacked(STORES / request.param, tmp_path)


def searched(home: Path) -> set[str]:
    """What is found in the place of submap a; opening the store migrates it."""
    world = sqlite_world(home)
    try:
        key = SubmapKey(POSTED.map_id, POSTED.session_id, "a")
        found = asyncio.run(world.use_cases.searches.by_submap(TENANT, key, SearchCriteria(k=1)))
        return {hit.submap.submap_id for hit in found.hits}
    finally:
        world.context.transactions.close()


def test_a_store_of_an_earlier_version_opens_with_all_that_was_acknowledged(home, tmp_path):
    assert searched(home) == {"c"}
    found = survey(home)
    assert found.against(History.parse((tmp_path / "log").read_bytes())) == []
    assert found.states == STATES


def test_the_robots_of_then_go_on_with_it_now(home, tmp_path):
    undisturbed(home, tmp_path / "log", boot="boot-2")
    found = survey(home)
    assert found.against(History.parse((tmp_path / "log").read_bytes())) == []
    assert found.states == STATES


def schema_of(database: Path) -> dict[str, str]:
    """The statements that make it, by name, but for white space and quotes that name nothing more."""
    with closing(sqlite3.connect(database)) as connection:
        made = connection.execute("SELECT name, sql FROM sqlite_schema WHERE sql IS NOT NULL").fetchall()
    return {name: " ".join(re.sub(r"([(),])", r" \1 ", sql.replace('"', "")).split()) for name, sql in made}


def maps_of(database: Path) -> list[dict[str, object]]:
    """The rows of the maps, without their checksums."""
    with closing(sqlite3.connect(database)) as connection:
        connection.row_factory = sqlite3.Row
        return [{**row, "checksum": None} for row in map(dict, connection.execute("SELECT * FROM maps"))]


def test_a_new_database_has_the_schema_of_a_store_that_all_steps_made(tmp_path):
    home = unpacked(STORES / "schema-0024.zip", tmp_path)
    migrate(tmp_path / "new.db", "0024")
    assert schema_of(tmp_path / "new.db") == schema_of(home / "revisit.db")


def test_a_store_that_all_steps_made_becomes_one_of_today_and_again_what_it_was(tmp_path):
    database = unpacked(STORES / "schema-0024.zip", tmp_path) / "revisit.db"
    before = schema_of(database), maps_of(database)
    migrate(database)
    assert current_revision(database) == NEWEST_REVISION
    assert [row["profile"] for row in maps_of(database)] == ["product"] * len(before[1])
    migrate(database, "0024")
    assert (schema_of(database), maps_of(database)) == before and before[1]


def of_two_maps(database: Path) -> None:
    """What a version before wrote, numbered by the rows of the service: submaps, changes, events and a webhook."""
    with closing(sqlite3.connect(database)) as connection, connection:
        town, annex = (row["map_id"] for row in maps_of(database)[:2])
        connection.execute("DELETE FROM events")
        rows = [(50, "", "FORGOTTEN"), (51, town, "OPERATION"), (52, annex, "OPERATION"), (53, town, "OPERATION")]
        connection.executemany("INSERT INTO events VALUES (?, 'default', ?, ?, 'op', NULL)", rows)
        hook = (1, "default", "hook", "hash", "https://example.org", None, "[]", "secret", "ENABLED", 52, 0, 0, 1, None)
        connection.execute(f"INSERT INTO webhooks VALUES ({', '.join('?' * len(hook))})", hook)


def test_numbers_that_clients_hold_stay_good_when_they_begin_to_count_within_a_map(tmp_path):
    database = unpacked(STORES / "schema-0024.zip", tmp_path) / "revisit.db"
    of_two_maps(database)
    migrate(database)
    store = SqliteTransactions(database, checkpoints=True)
    town, annex = store.read_here(lambda uow: uow.maps.find(DEFAULT_TENANT))[:2]

    def following(record, after):
        rows = store.read_here(lambda uow: uow.events.following(DEFAULT_TENANT, record.map_id, after, 10))
        return [(row.number, row.kind) for row in rows]

    assert following(town, 0) == [(50, "FORGOTTEN"), (51, "OPERATION"), (53, "OPERATION")]
    assert following(annex, 51) == [(52, "OPERATION")]
    (hook,) = store.read_here(lambda uow: uow.webhooks.due(10))
    assert store.read_here(lambda uow: uow.webhooks.news(hook)).keys() == {town.map_id, annex.map_id}
    for record in (town, annex):
        event = EventRecord(DEFAULT_TENANT, record.map_id, "OPERATION", "x")
        store.write(lambda uow, event=event: uow.events.record(event)).result()
        assert following(record, 53) == [(54, "OPERATION")]
        submaps = store.read_here(lambda uow, of=record: uow.submaps.find(DEFAULT_TENANT, map_id=of.map_id))
        assert [one.seq for one in submaps] == [one.number for one in submaps]
        changes = store.read_here(lambda uow, of=record: uow.changes.since(DEFAULT_TENANT, of.number, 0))
        store.write(lambda uow, of=record: uow.changes.record_removed(of, [1])).result()
        last = changes[-1].seq if changes else 0
        (added,) = store.read_here(lambda uow, of=record, last=last: uow.changes.since(DEFAULT_TENANT, of.number, last))
        assert added.seq == last + 1
    store.close()
    migrate(database, "0024")
    with closing(sqlite3.connect(database)) as connection:
        numbers = [number for (number,) in connection.execute("SELECT number FROM events ORDER BY number")]
    assert numbers[:3] == [51, 52, 53] and len(numbers) == 5


def test_a_store_with_a_map_in_the_form_of_the_paper_does_not_become_an_older_one(tmp_path):
    database = unpacked(STORES / "schema-0024.zip", tmp_path) / "revisit.db"
    migrate(database)
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("UPDATE maps SET profile = 'paper'")
    with pytest.raises(ForeignSchema, match="in the profile of the paper"):
        migrate(database, "0024")
    assert current_revision(database) == NEWEST_REVISION
    assert {row["profile"] for row in maps_of(database)} == {"paper"}


def test_a_store_that_a_later_release_has_upgraded_is_refused_until_that_release_takes_it_back(tmp_path, monkeypatch):
    home = unpacked(STORES / "release-0.2.0.zip", tmp_path)
    with monkeypatch.context() as later:
        later.setattr(schema, "MIGRATIONS", migrations_with_a_next_step(tmp_path))
        later.setattr(schema, "NEWEST_REVISION", NEXT_REVISION)
        migrate(home / "revisit.db")
        upgraded = hashlib.sha256((home / "revisit.db").read_bytes()).hexdigest()
        later.undo()
        with pytest.raises(ForeignSchema, match=f"newer Revisit .schema {NEXT_REVISION}.* or restore a backup"):
            migrate(home / "revisit.db")
    assert hashlib.sha256((home / "revisit.db").read_bytes()).hexdigest() == upgraded
    with monkeypatch.context() as later:
        later.setattr(schema, "MIGRATIONS", tmp_path / "migrations")
        migrate(home / "revisit.db", NEWEST_REVISION)
    assert current_revision(home / "revisit.db") == NEWEST_REVISION
    assert searched(home) == {"c"}
    assert survey(home).against(History.parse((tmp_path / "log").read_bytes())) == []


def test_every_release_since_0_2_0_has_left_a_store():
    released = re.findall(r"^## (\d+\.\d+\.\d+) - \d", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert [
        version for version in released if version != "0.1.0" and not (STORES / f"release-{version}.zip").is_file()
    ] == []
    assert "0.1.0" in released


def test_a_store_of_today_can_be_made(tmp_path):
    write_store(tmp_path / "today.zip")
    home = unpacked(tmp_path / "today.zip", tmp_path)
    assert survey(home).states == STATES
