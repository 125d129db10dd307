"""An installation moves to PostgreSQL and a bucket, and back, and is the same."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from contextlib import closing
from itertools import count
from multiprocessing import get_context

import pytest
from sqlalchemy import select
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.service.domain.identity import SubmapKey, TenantId
from revisit.service.engines import move
from revisit.service.engines.local.files.blobs import FileBlobStore
from revisit.service.engines.local.files.home_lock import sole_gateway
from revisit.service.engines.local.sqlite import connections as sqlite
from revisit.service.engines.local.sqlite.examination import examine
from revisit.service.engines.local.sqlite.migration import migrate
from revisit.service.engines.move import MoveRefused, digest, move_blobs, move_rows, require_empty
from revisit.service.engines.postgres import connections as postgres
from revisit.service.engines.postgres.transactions import PostgresTransactions
from revisit.service.engines.s3.blobs import S3BlobStore
from revisit.service.features.audit.calls import judge
from revisit.service.moving import NOTE, move_installation
from revisit.service.settings import Settings
from tests.faults.drive import undisturbed
from tests.support.credentials import a_key
from tests.support.live_service import connected, live_service, published_drives
from tests.support.patience import PATIENCE_S
from tests.support.postgres import shared_server
from tests.support.s3 import nanio, variables
from tests.support.service_world import SESSION, TENANT, _world, open_session, policy, sqlite_world, submap
from tests.support.stepped_clock import SteppedClock
from tests.support.stored_rows import run


def quiet(_name: str, _count: int) -> None:
    """Nobody is told."""


@pytest.fixture
def home(tmp_path):
    """A data folder in use: a map with loops, a deleted submap (so that a number is free), a key, a job that waits."""
    world = sqlite_world(tmp_path / "home")
    asyncio.run(_used(world))
    a_key(world)
    world.context.transactions.close()
    return tmp_path / "home"


async def _used(world):
    await open_session(world)
    for number in range(6):
        await world.use_cases.posting.post(TENANT, submap(f"s{number}", number // 2))
    world.work_off()
    await world.use_cases.submaps.delete(TENANT, SubmapKey(SESSION.map_id, SESSION.session_id, "s5"))
    await world.use_cases.posting.post(TENANT, submap("waits", 9))


@pytest.fixture
def server():
    return shared_server()


def engines(home, url):
    return sqlite.writer_engine(home / sqlite.DATABASE, checkpoints=True), postgres.writer_engine(url)


def moved(source, target):
    require_empty(target)
    move_rows(source, target, quiet)


def moved_back(target, folder):
    """The engine of a new store in `folder` with the rows of `target`."""
    folder.mkdir()
    migrate(folder / sqlite.DATABASE)
    back = sqlite.writer_engine(folder / sqlite.DATABASE, checkpoints=True)
    moved(target, back)
    return back


async def test_rows_are_the_same_in_postgresql_and_back_again(home, tmp_path, server):
    source, target = engines(home, server.made_database())
    moved(source, target)
    there = digest(target)
    assert there == digest(source)
    assert there[0]["submaps"] == 6 and there[0]["loop_events"] >= 0 and there[0]["jobs"] > 6
    back = moved_back(target, tmp_path / "back")
    assert digest(back) == there
    for engine in (source, target, back):
        engine.dispose()


LEFT_EMPTY = {
    "anchors": {"heading_rad", "heading_sigma_rad"},
    "jobs": {"request_id", "traceparent"},
    "maps": {
        *("tau_m", "stride_m", "leave_distance_m", "loop_candidates", "min_score", "min_overlap", "max_seen_through"),
        *("retention", "retention_run"),
    },
    "plans": {"storey"},
    "sessions": {"robot_id", "storey", "stream", "changes_told"},
}
"""Columns in which the drive leaves nothing: the move of their values rests on that of other columns of the type."""


def empty_columns(engine):
    """Table -> the columns that are NULL in each of its rows."""
    found = {}
    with engine.begin() as connection:
        for table in move.moved_tables():
            rows = connection.execute(select(table)).mappings().all()
            names = {column.name for column in table.columns if column.name != move.CHECKSUM}
            if rows and (empty := {name for name in names if all(row[name] is None for row in rows)}):
                found[table.name] = empty
    return found


def test_what_a_whole_drive_has_left_is_the_same_in_postgresql_and_back_again(tmp_path, server):
    """Every table with rows that a client has caused: anchors, versions with verdicts on them, changes, merges."""
    (tmp_path / "home").mkdir()
    undisturbed(tmp_path / "home", tmp_path / "log")
    source, target = engines(tmp_path / "home", server.made_database())
    moved(source, target)
    there = digest(target)
    assert there == digest(source)
    filled = {name for name, rows in there[0].items() if rows}
    assert {
        "anchors",
        "loop_events",
        "map_files",
        "map_merges",
        "map_tiles",
        "map_versions",
        "plans",
        "radio_readings",
    } <= filled
    assert empty_columns(target) == LEFT_EMPTY
    back = moved_back(target, tmp_path / "back")
    assert digest(back) == there
    for engine in (source, target, back):
        engine.dispose()
    assert complaints(tmp_path / "back") == []


def complaints(home) -> list[str]:
    """Rows that are not what was written, and references that dangle."""
    checks = ("rows", "references", "database", "schema")
    return [one.detail for one in examine(home, full=True) if one.ok is False and one.check in checks]


async def test_a_broken_move_goes_on_where_it_ended(home, server, monkeypatch):
    monkeypatch.setattr(move, "PORTION", 2)
    source, target = engines(home, server.made_database())
    portions = []

    def breaks(name, count):
        portions.append((name, count))
        if len(portions) == 9:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        move_rows(source, target, breaks)
    came = sum(count for _, count in portions)
    move_rows(source, target, breaks)
    assert digest(target) == digest(source)
    assert sum(count for _, count in portions) == sum(digest(source)[0].values()) > came
    source.dispose(), target.dispose()


def test_a_move_that_is_killed_again_and_again_goes_on_until_all_is_there(home, tmp_path, server, monkeypatch):
    monkeypatch.setattr(move, "PORTION", 2)
    url, there = server.made_database(), tmp_path / "there"
    target = Settings(home=there, database_url=url.render_as_string(hide_password=False))
    for call in (1, 12, 30):
        mover = get_context("fork").Process(target=killed_at, args=(call, Settings(home=home), target))
        mover.start()
        mover.join(PATIENCE_S)
        assert mover.exitcode == -signal.SIGKILL
    told = move_installation(Settings(home=home), target, quiet)
    assert told.rows["submaps"] == 6 and not (home / NOTE).exists()
    engine = postgres.writer_engine(url)
    assert digest(engine) == (told.rows, told.sha256)
    engine.dispose()


def killed_at(call: int, source: Settings, target: Settings) -> None:
    """Move until so much has come, then die."""
    calls = count(1)

    def progress(_name: str, _count: int) -> None:
        if next(calls) == call:
            os.kill(os.getpid(), signal.SIGKILL)

    move_installation(source, target, progress)


async def test_a_place_with_rows_is_refused(home, server):
    source, target = engines(home, server.made_database())
    moved(source, target)
    with pytest.raises(MoveRefused, match="maps"):
        require_empty(target)
    source.dispose(), target.dispose()


async def test_blobs_come_once_each_and_checked(home, tmp_path):
    source, target = FileBlobStore(home / "blobs"), FileBlobStore(tmp_path / "elsewhere")
    rows = sqlite.writer_engine(home / sqlite.DATABASE, checkpoints=True)
    count = move_blobs(rows, source, target, quiet)
    stored = {(blob.tenant, blob.kind, blob.sha256) for blob in target.stored(0.0)}
    assert len(stored) == count > 6
    for tenant, kind, sha256 in stored:
        assert target.get(TenantId(tenant), kind, sha256) == source.get(TenantId(tenant), kind, sha256)
    assert move_blobs(rows, source, target, quiet) == count
    rows.dispose()


async def test_the_service_goes_on_from_the_moved_rows(home, server):
    url = server.made_database()
    source, target = engines(home, url)
    moved(source, target)
    source.dispose(), target.dispose()
    clock = SteppedClock()
    with closing(PostgresTransactions(url, lease_ms=10_000, clock=clock, now_ms=lambda _: clock.ms)) as transactions:
        world = _world(transactions, FileBlobStore(home / "blobs"), policy(), clock)
        assert world.work_off() == 1, "the job that waited"
        posted = await world.use_cases.posting.post(TENANT, submap("later", 1))
        row = transactions.read(lambda uow: uow.submaps.get(*_named(posted))).result()
        assert row.number > 7, "the number of the deleted submap is not given again"
        assert world.work_off() >= 1
        audited = transactions.read(lambda uow: uow.audit.since(0, 100)).result()
        assert len(audited) > 1 and judge(audited, len(audited)).fault is None


def test_a_person_moves_an_installation_by_typing_and_a_served_one_is_refused(home, tmp_path, server):
    url, run = server.made_database().render_as_string(hide_password=False), CliRunner()
    there = ["move", "--home", str(home), "--to-database", url, "--to-home", str(tmp_path / "there"), "--json"]
    with sole_gateway(home):
        served = run.invoke(app, there)
    assert served.exit_code == 1 and "is served by another gateway" in served.stderr
    moved = run.invoke(app, there)
    assert moved.exit_code == 0, moved.output
    told = json.loads(moved.stdout)
    assert told["rows"]["submaps"] == 6 and told["blobs"] > 6
    again = run.invoke(app, there)
    assert again.exit_code == 1 and "has rows already" in again.stderr
    back = [*there[:1], "--home", str(tmp_path / "there"), "--to-home", str(tmp_path / "back"), "--json"]
    returned = run.invoke(app, back, env={"REVISIT_DATABASE_URL": url})
    assert returned.exit_code == 0, returned.output
    assert json.loads(returned.stdout) == told
    assert sorted(path.name for path in (tmp_path / "back" / "blobs").rglob("*") if path.is_file()) == sorted(
        path.name for path in (tmp_path / "there" / "blobs").rglob("*") if path.is_file()
    )


def test_what_a_client_downloads_is_the_same_from_files_from_a_bucket_and_from_files_again(
    tmp_path, server, monkeypatch
):
    there, run = server.made_database(), CliRunner()
    for name, value in variables(nanio().address).items():
        monkeypatch.setenv(name, value)
    bucket = f"s3://{nanio().new_bucket()}/fleet"
    first = sqlite_world(tmp_path / "first")
    before = downloaded(first, tmp_path, drive=True)
    to_bucket = ["move", "--home", str(tmp_path / "first"), "--to-blobs", bucket, "--to-database"]
    moved = run.invoke(app, [*to_bucket, there.render_as_string(hide_password=False)])
    assert moved.exit_code == 0, moved.output
    clock = SteppedClock()
    transactions = PostgresTransactions(there, lease_ms=10_000, clock=clock, now_ms=lambda _: clock.ms)
    assert downloaded(_world(transactions, S3BlobStore(bucket), policy(), clock), tmp_path) == before
    back = ["move", "--home", str(tmp_path / "first"), "--to-home", str(tmp_path / "back")]
    of_cluster = {"REVISIT_DATABASE_URL": there.render_as_string(hide_password=False), "REVISIT_BLOB_URL": bucket}
    returned = run.invoke(app, back, env=of_cluster)
    assert returned.exit_code == 0, returned.output
    assert downloaded(sqlite_world(tmp_path / "back"), tmp_path) == before


def downloaded(world, folder, *, drive=False):
    """The bytes of a map file and of a mesh, and the loops, as a client gets them; the world is closed then."""
    with closing(world.context.transactions), live_service(world) as service, connected(service, "rest") as client:
        published = published_drives(client) if drive else client.map_files("town")[0]
        client.download_map_file(published, folder / "town.rvmap")
        mesh = client.download("maps/town/sessions/monday/submaps/s1", "mesh")
        loops = sorted((loop.name, loop.state, loop.score) for loop in client.loop_closures("maps/town", state="ALL"))
        assert len(loops) >= 3
        return (folder / "town.rvmap").read_bytes(), mesh, loops


def test_without_a_new_place_nothing_is_moved(home):
    refused = CliRunner().invoke(app, ["move", "--home", str(home)])
    assert refused.exit_code == 1 and "name the new place of the state" in refused.stderr


def _named(posted):
    return TENANT, SESSION.map_id, SESSION.session_id, posted.submap.key.submap_id


def test_a_damaged_row_is_not_moved_to_where_it_would_seem_whole(home, tmp_path):
    run(home / "revisit.db", "UPDATE submaps SET stamp_ns = stamp_ns + 1 WHERE number = 1")
    with pytest.raises(MoveRefused, match="1 are not what was written: submaps 1"):
        move_installation(Settings(home=home), Settings(home=tmp_path / "there"), quiet)
    assert [one.detail for one in examine(home, full=True) if one.ok is False] == [
        "1 are not what was written: submaps 1"
    ]
