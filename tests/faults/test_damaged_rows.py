"""A flipped bit anywhere in the file of the database is noticed and named, or changes nothing that anybody reads.

REVISIT_TEST_FLIPS (1000) is the full size.
"""

from __future__ import annotations

import os
import random
import sqlite3
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from revisit.core.errors import DataLoss
from revisit.core.index import FaissIndex
from revisit.service.engines import schema
from revisit.service.engines.local.sqlite import migration, row_checksums
from revisit.service.engines.local.sqlite.backup import make_backup, restore_backup
from revisit.service.engines.local.sqlite.backup_key import own_key
from revisit.service.engines.local.sqlite.examination import examine, scrub
from revisit.service.engines.local.sqlite.row_checksums import damaged_rows
from revisit.service.engines.local.vector_index import PlaceVectorIndex
from revisit.service.features.index.caught_up_index import CaughtUpIndex
from revisit.service.features.index.place_memory import SearchCriteria
from revisit.service.features.resources.paging import PageRequest
from tests.faults.drive import undisturbed
from tests.support.figures import publish
from tests.support.next_migration import NEXT_REVISION, migrations_with_a_next_step
from tests.support.service_world import SESSION, TENANT, described, sqlite_world, submap
from tests.support.stored_rows import run

DATABASE = "revisit.db"
FLIPS = int(os.environ.get("REVISIT_TEST_FLIPS", "1000"))


@pytest.fixture(scope="module")
def driven(tmp_path_factory) -> Path:
    """The folder of a stopped service that has done everything once."""
    folder = tmp_path_factory.mktemp("driven")
    (folder / "home").mkdir()
    undisturbed(folder / "home", folder / "log")
    return folder / "home"


@pytest.fixture
def database(tmp_path, driven) -> Path:
    """A copy of the database of that service."""
    copy = tmp_path / DATABASE
    copy.write_bytes((driven / DATABASE).read_bytes())
    return copy


def content(database: Path) -> dict:
    """Every row and the schema, as any reader of the file sees them."""
    with closing(sqlite3.connect(f"file:{database}?mode=ro&immutable=1", uri=True)) as connection:
        schema = connection.execute("SELECT type, name, tbl_name, sql FROM sqlite_master").fetchall()
        tables = [row[1] for row in schema if row[0] == "table"]
        return {"schema": schema} | {
            table: connection.execute(f"SELECT rowid, * FROM '{table}'").fetchall()  # own schema
            for table in tables
        }


def complaints(home: Path) -> list[str]:
    return [f"{finding.check}: {finding.detail}" for finding in examine(home, full=True) if finding.ok is False]


def flipped(home: Path, flips: int, seed: int) -> Counter[str]:
    """Flip single bits of the database, one at a time: what came of them."""
    database, rng, outcomes = home / DATABASE, random.Random(seed), Counter[str]()
    whole, before = database.read_bytes(), content(database)
    assert complaints(home) == []
    for _ in range(flips):
        at, bit = rng.randrange(len(whole)), 1 << rng.randrange(8)
        database.write_bytes(whole[:at] + bytes([whole[at] ^ bit]) + whole[at + 1 :])
        try:
            same = content(database) == before
        except (sqlite3.Error, UnicodeError):
            same = False
        noticed = complaints(home)
        outcomes["noticed" if noticed else "without effect" if same else f"silent: bit {bit} of byte {at}"] += 1
    database.write_bytes(whole)
    return outcomes


def test_a_flipped_bit_of_the_database_is_noticed_or_without_effect(driven):
    outcomes = flipped(driven, 60, seed=1)
    assert not [outcome for outcome in outcomes if outcome.startswith("silent")]
    assert outcomes["noticed"] > 5  # most of the file of a short drive is room without rows


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_any_flipped_bit_of_the_database_is_noticed_or_without_effect(driven):
    outcomes = flipped(driven, FLIPS, seed=int(os.environ.get("REVISIT_TEST_SEED", "2")))
    publish("flipped bits of the database", flips=FLIPS, **outcomes)
    assert not [outcome for outcome in outcomes if outcome.startswith("silent")]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ("UPDATE submaps SET descriptor = zeroblob(length(descriptor)) WHERE number = 1", "submaps 1"),
        ("UPDATE submaps SET stamp_ns = stamp_ns + 1 WHERE number = 1", "submaps 1"),
        ("UPDATE sessions SET state = 'ACTIVF'", "sessions 1"),
        ("UPDATE loop_closures SET score = score * 1.0000001 WHERE number = 1", "loop_closures 1"),
        ("UPDATE maps SET checksum = checksum + 1", "maps 1"),
        ("UPDATE maps SET checksum = NULL", "maps 1"),
        ("UPDATE alembic_version SET version_num = '0018'", "the schema"),
        ("UPDATE sqlite_sequence SET seq = 0 WHERE name = 'submaps'", "the counter of submaps"),
        ("UPDATE sqlite_sequence SET name = 'tubmaps' WHERE name = 'submaps'", "the counter of submaps"),
    ],
)
def test_what_was_changed_beside_the_service_is_named(database, change, named):
    run(database, change)
    with closing(sqlite3.connect(database)) as connection:
        assert named in list(damaged_rows(connection))


def test_a_change_of_any_value_of_any_table_is_named(database):
    changed = set()
    with closing(sqlite3.connect(database, isolation_level=None)) as connection:
        assert list(damaged_rows(connection)) == []
        for table, arguments in row_checksums._tables(connection).items():
            (rowid,) = connection.execute(f'SELECT max(rowid) FROM "{table}"').fetchone()
            names = [row[1] for row in connection.execute(f'PRAGMA table_info("{table}")')] if rowid else []
            for name in names:
                connection.execute("BEGIN")
                connection.execute(f'UPDATE "{table}" SET "{name}" = {OTHER.format(name)} WHERE rowid = {rowid}')
                assert len(list(row_checksums._wrong_rows(connection, table, arguments))) == 1, (table, name)
                connection.execute("ROLLBACK")
                changed.add(table)
    assert {"anchors", "map_merges", "map_tiles", "map_versions", "scans", "sessions", "jobs", "maps"} <= changed


OTHER = """CASE typeof("{0}") WHEN 'integer' THEN "{0}" + 1 WHEN 'real' THEN "{0}" * 1.0000001 + 1e-9
    WHEN 'text' THEN "{0}" || 'x' WHEN 'blob' THEN CAST("{0}" || x'00' AS BLOB) ELSE 1 END"""
"""Another value of the same kind."""


async def test_every_way_to_look_names_a_damaged_row_and_a_backup_of_it_is_not_taken_for_whole(tmp_path):
    home = tmp_path / "home"
    world = sqlite_world(home)
    await described(world, a=1)
    world.context.transactions.close()
    make_backup(home, tmp_path / "whole", "test")
    run(home / DATABASE, "UPDATE submaps SET scan_count = scan_count + 1")
    assert complaints(home) == ["rows: 1 are not what was written: submaps 1"]
    assert scrub(home).rows == ("submaps 1",)
    assert make_backup(home, tmp_path / "damaged", "test").lost == ("submaps 1",)
    restore_backup(tmp_path / "whole", tmp_path / "again", own_key(home))
    # A backup that was made of a whole store, of rows that are damaged: only with hash and signature made anew.
    manifest = make_backup(home, tmp_path / "forged", "test")
    assert manifest.lost == ("submaps 1",)


async def test_a_submap_whose_descriptor_is_damaged_is_refused_by_itself_and_nobody_else(tmp_path, caplog):
    world = sqlite_world(tmp_path)
    await described(world, a=1, b=2, c=1)
    run(
        tmp_path / DATABASE,
        "UPDATE submaps SET descriptor = CAST(substr(descriptor, 1, 8) || zeroblob(4) "
        "|| substr(descriptor, 13) AS BLOB) "
        "WHERE submap_id = 'a'",
    )
    index = PlaceVectorIndex(FaissIndex)
    (record,) = world.context.transactions.read(lambda uow: uow.maps.find(TENANT)).result()
    CaughtUpIndex(world.context.transactions, index).catch_up(TENANT, record.number)
    rows = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT)).result()
    sound = {row.submap_id: row.number for row in rows}
    assert index.numbers(record.number)[1].tolist() == [sound["b"], sound["c"]]
    with pytest.raises(DataLoss, match="submaps/a is damaged"):
        await world.use_cases.searches.by_submap(TENANT, submap("a", 1).key, SearchCriteria())
    with pytest.raises(DataLoss):
        await world.use_cases.submaps.get(TENANT, submap("a", 1).key, full=True)
    assert len((await world.use_cases.submaps.list(TENANT, SESSION, PageRequest())).items) == 3
    world.context.transactions.close()


def upgrade(database, tmp_path, monkeypatch):
    """To a schema with one step more than today's."""
    monkeypatch.setattr(schema, "MIGRATIONS", migrations_with_a_next_step(tmp_path))
    monkeypatch.setattr(schema, "NEWEST_REVISION", NEXT_REVISION)
    migration.migrate(database)


def test_an_upgrade_gives_every_row_its_checksum(database, tmp_path, monkeypatch):
    upgrade(database, tmp_path, monkeypatch)
    assert migration.current_revision(database) == NEXT_REVISION
    with closing(sqlite3.connect(database)) as connection:
        assert list(damaged_rows(connection)) == []
    run(database, "UPDATE scans SET point_count = point_count + 1 WHERE number = 1")
    with closing(sqlite3.connect(database)) as connection:
        assert list(damaged_rows(connection)) == ["scans 1"]


def test_a_damaged_row_stays_named_through_changes_and_upgrades(database, tmp_path, monkeypatch):
    run(database, "UPDATE submaps SET stamp_ns = stamp_ns + 1 WHERE number = 1")
    run(database, "UPDATE maps SET created_at_ns = created_at_ns + 1 WHERE map_id = 'town'")
    named = damaged_in(database)
    assert len(named) == 2
    with keeping(database) as connection:
        connection.execute("UPDATE submaps SET map_version = map_version + 1")
        connection.execute("UPDATE maps SET created_at_ns = created_at_ns + 1")
    assert damaged_in(database) == named
    upgrade(database, tmp_path, monkeypatch)
    assert damaged_in(database) == named


def test_damaged_counters_are_raised_by_nobody(database):
    run(database, "UPDATE map_counters SET events = events - 1 WHERE map_id = 'town'")
    with keeping(database) as connection, pytest.raises(sqlite3.OperationalError):
        connection.execute("UPDATE map_counters SET events = events + 1")
    assert len(damaged_in(database)) == 1


def test_rows_with_a_damaged_text_are_named_beside_others_and_through_an_upgrade(database, tmp_path, monkeypatch):
    run(database, "UPDATE scans SET cloud_sha256 = CAST(x'ff' AS TEXT) WHERE number = 1")
    run(database, "UPDATE scans SET stamp_ns = stamp_ns + 1 WHERE number = 2")
    named = damaged_in(database)
    assert named == ["scans 1", "scans 2"]
    upgrade(database, tmp_path, monkeypatch)
    assert damaged_in(database) == named


def test_a_damaged_descriptor_stays_refused_until_there_is_another(database):
    run(database, "UPDATE submaps SET descriptor = CAST(x'02' || substr(descriptor, 2) AS BLOB) WHERE number = 1")
    with keeping(database) as connection:
        connection.execute("UPDATE submaps SET map_version = map_version + 1")
    assert not sound(database)
    with keeping(database) as connection:
        connection.execute("UPDATE submaps SET descriptor = CAST(x'01' || substr(descriptor, 2) AS BLOB)")
    assert sound(database) and damaged_in(database) == []


@pytest.mark.parametrize("stored", [None, 1.5, "x", b"x"])
def test_a_row_with_a_checksum_of_another_kind_can_be_changed_and_stays_damaged(database, stored):
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("UPDATE plans SET checksum = ?", (stored,))
        connection.commit()
    with keeping(database) as connection:
        connection.execute("UPDATE plans SET display_name = 'other'")
    assert [name.split()[0] for name in damaged_in(database)] == ["plans"]


def damaged_in(database: Path) -> list[str]:
    with closing(sqlite3.connect(database)) as connection:
        return list(damaged_rows(connection))


def sound(database: Path) -> bool:
    """Whether the descriptor of the first submap is what its checksum says."""
    ((descriptor, checksum),) = run(database, "SELECT descriptor, checksum FROM submaps WHERE number = 1")
    return zlib.crc32(descriptor) == checksum & 0xFFFFFFFF


@contextmanager
def keeping(database: Path) -> Iterator[sqlite3.Connection]:
    """A connection that keeps checksums as the service's writer does."""
    with closing(sqlite3.connect(database)) as connection:
        row_checksums.keep_checksums(connection)
        yield connection
        connection.commit()
