"""A session or map is deleted by one row; what was in it is seen by nobody and goes in portions, between other writes.

REVISIT_DELETED_SCANS (3000): scans of the session; the full size is in `load/test_deletion.py`.
"""

from __future__ import annotations

import os
from contextlib import contextmanager
from dataclasses import replace

import pytest

from revisit.core.index import FaissIndex
from revisit.service.domain.errors import NotFound, StillDeleting
from revisit.service.domain.identity import SessionKey
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.engines.local.vector_index import PlaceVectorIndex
from revisit.service.engines.sql.repositories import SqlRepository
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.deletion import erasure
from revisit.service.features.index.keeping import IndexHealth
from revisit.service.features.resources.paging import PageRequest
from revisit.service.features.upkeep.sweeping import UNREFERENCED_S, collect
from tests.support.records import a_scan
from tests.support.service_world import (
    SESSION,
    TENANT,
    described,
    memory_world,
    open_session,
    posted,
    sqlite_world,
    submap,
)
from tests.support.stored_rows import run

SCANS = int(os.environ.get("REVISIT_DELETED_SCANS", "3000"))
OTHER = SessionKey("town", "tuesday")
MOST_ROWS = 1000
"""Rows that one transaction of a deletion may change: at 100 us a row it takes 100 ms."""
IN_A_MAP = (
    *("maps", "sessions", "scans", "submaps", "loop_closures", "loop_events", "session_poses", "map_versions"),
    *("map_tiles", "map_files", "early_corrections", "anchors", "radio_readings", "plans", "deletions"),
)


def fill_with_scans(world, count: int = SCANS) -> None:
    scans = [a_scan(seq, float(seq)) for seq in range(1, count + 1)]
    scans = [replace(scan, cloud_sha256=f"{scan.seq:064x}") for scan in scans]
    world.context.transactions.write(lambda uow: uow.scans.add_all(scans)).result()


async def removed(world, what: str) -> None:
    if what == "session":
        await world.use_cases.sessions.delete(TENANT, SESSION)
    else:
        await world.use_cases.maps.delete(TENANT, SESSION.map_id)


@contextmanager
def nothing_erased(monkeypatch):
    """As where the gateway ends as soon as the mark is committed."""
    with monkeypatch.context() as patch:
        patch.setattr(erasure.Erasure, "soon", lambda *_: _nothing())
        yield


async def _nothing() -> None:
    pass


@pytest.fixture(params=[memory_world, sqlite_world], ids=["memory", "sqlite"])
def world(request, tmp_path):
    made = request.param() if request.param is memory_world else request.param(tmp_path)
    yield made
    made.context.transactions.close()


@pytest.mark.parametrize("what", ["session", "map"])
async def test_no_transaction_of_a_deletion_changes_many_rows(tmp_path, monkeypatch, what):
    world, changed = sqlite_world(tmp_path), []
    await open_session(world)
    fill_with_scans(world)
    transaction = SqliteTransactions._transaction

    @contextmanager
    def counted(self):
        with transaction(self) as connection:
            before = connection.connection.dbapi_connection.total_changes
            yield connection
            changed.append(connection.connection.dbapi_connection.total_changes - before)

    monkeypatch.setattr(SqliteTransactions, "_transaction", counted)
    monkeypatch.setattr(
        world.context.transactions,
        "_writing",
        type(world.context.transactions._writing)(world.context.transactions._transaction),
    )
    await removed(world, what)
    await world.context.erasure.all()
    world.context.transactions.close()
    assert sum(changed) > SCANS
    assert max(changed) <= MOST_ROWS
    assert run(tmp_path / "revisit.db", "SELECT count(*) FROM scans") == [(0,)]


@pytest.mark.parametrize(("ms_a_row", "at_a_time"), [(0.01, 300), (1, 40), (10, 15)])
async def test_portions_are_as_many_rows_as_the_machine_deletes_in_a_moment(tmp_path, monkeypatch, ms_a_row, at_a_time):
    world, deleted = sqlite_world(tmp_path), []
    delete_some = SqlRepository.delete_some

    def noted(*asked):
        deleted.append(delete_some(*asked))
        return deleted[-1]

    monkeypatch.setattr(SqlRepository, "delete_some", noted)
    monkeypatch.setattr(erasure, "_now_s", lambda: ms_a_row * sum(deleted) / 1000)
    await open_session(world)
    fill_with_scans(world, 800)
    await removed(world, "session")
    await world.context.erasure.all()
    world.context.transactions.close()
    of_scans = [rows for rows in deleted if rows > 1]
    assert of_scans[0] == 300 and set(of_scans[4:-1]) <= {at_a_time}
    assert sum(deleted) > 800


@pytest.mark.parametrize("what", ["session", "map"])
async def test_what_is_being_deleted_is_seen_by_nobody(world, monkeypatch, what):
    await described(world, a=1, b=2)
    await posted(world, c=3)
    await posted(world, OTHER, d=1)
    world.work_off()
    with nothing_erased(monkeypatch):
        await removed(world, what)
    use_cases, everything = world.use_cases, PageRequest()
    with pytest.raises(NotFound):
        await use_cases.sessions.get(TENANT, SESSION)
    with pytest.raises(NotFound):
        await use_cases.submaps.get(TENANT, submap("a", 1).key)
    with pytest.raises(NotFound):
        await use_cases.posting.post(TENANT, submap("new", 4))
    with pytest.raises(NotFound):
        await removed(world, what)
    if what == "map":
        assert (await use_cases.maps.list(TENANT, everything)).items == ()
        return
    assert [view.key for view in (await use_cases.sessions.list(TENANT, "town", everything)).items] == [OTHER]
    seen = await use_cases.maps.get(TENANT, "town")
    assert (seen.session_count, seen.submap_count) == (1, 1)

    def rows(uow):
        left = (uow.submaps, uow.loops, uow.loop_events, uow.scans)
        return [kind.count(TENANT, map_id="town") for kind in left], uow.submaps.first_waiting(TENANT, "town")

    assert world.context.transactions.read(rows).result() == ([1, 0, 0, 0], None)


async def test_no_search_finds_what_is_being_deleted(world, monkeypatch):
    await described(world, a=1, b=2)
    await posted(world, OTHER, d=1)
    world.work_off()
    index = PlaceVectorIndex(FaissIndex)
    context = replace(world.context, index=index, index_health=IndexHealth())
    keeper = context.index_keeper()
    await keeper.load()
    (before,) = world.context.transactions.read(lambda uow: uow.maps.find(TENANT)).result()
    assert len(index.numbers(before.number)[1]) == 3
    with nothing_erased(monkeypatch):
        await removed(world, "session")
    assert [await keeper.audit() for _ in range(3)] == [0, 0, 0]
    (other,) = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT)).result()
    assert index.numbers(before.number)[1].tolist() == [other.number]
    # Who loads it anew, from rows of which some are still there, has the same.
    afresh = replace(world.context, index=PlaceVectorIndex(FaissIndex), index_health=IndexHealth())
    await afresh.index_keeper().load()
    assert afresh.index.numbers(before.number)[1].tolist() == [other.number]
    await world.context.erasure.all()
    assert [await keeper.audit() for _ in range(3)] == [0, 0, 0]


async def test_an_id_is_free_again_once_all_of_it_is_gone(world, monkeypatch):
    await described(world, a=1)
    with nothing_erased(monkeypatch):
        await removed(world, "session")
    again = CreateSession(SESSION.map_id, SESSION.session_id)
    with pytest.raises(StillDeleting, match="free again soon"):
        await world.use_cases.sessions.create(TENANT, again)
    await world.context.erasure.all()
    assert (await world.use_cases.sessions.create(TENANT, again)).session.submap_count == 0
    with nothing_erased(monkeypatch):
        await removed(world, "map")
    with pytest.raises(StillDeleting):
        await world.use_cases.maps.create(TENANT, CreateMap("town"))
    await world.context.erasure.all()
    assert not (await world.use_cases.maps.create(TENANT, CreateMap("town"))).replay


async def test_a_map_that_is_deleted_while_a_session_of_it_goes_takes_that_with_it(world, monkeypatch):
    await described(world, a=1)
    with nothing_erased(monkeypatch):
        await removed(world, "session")
        await removed(world, "map")
    await world.context.erasure.all()
    await posted(world, a=1)
    assert (await world.use_cases.sessions.get(TENANT, SESSION)).submap_count == 1


@pytest.mark.parametrize("what", ["session", "map"])
async def test_a_deletion_that_was_cut_off_goes_on_after_a_restart(tmp_path, monkeypatch, what):
    world = sqlite_world(tmp_path)
    await described(world, a=1, b=2, c=1)
    fill_with_scans(world, 10)
    monkeypatch.setattr(erasure, "ROWS", 4)
    monkeypatch.setattr(erasure, "SUBMAPS", 1)
    with nothing_erased(monkeypatch):
        await removed(world, what)
    world.context.transactions.close()
    again = sqlite_world(tmp_path)
    await again.context.erasure.all()
    again.clock.ms += int(1000 * UNREFERENCED_S)
    await collect(again.context.storage)
    again.context.transactions.close()
    database = tmp_path / "revisit.db"
    left = {table: run(database, f"SELECT count(*) FROM {table}")[0][0] for table in IN_A_MAP}
    assert left == dict.fromkeys(IN_A_MAP, 0) | ({"maps": 1} if what == "session" else {})
    assert run(database, "PRAGMA foreign_key_check") == []
    assert [path for path in (tmp_path / "blobs").glob("*/*/??/*") if path.is_file()] == []


async def test_a_job_that_waits_is_dropped_with_its_submap_however_late_it_is_claimed(world, monkeypatch):
    await posted(world, a=1)
    with nothing_erased(monkeypatch):
        await removed(world, "session")
    assert world.work_off() == 1
    await world.context.erasure.all()
    (job,) = world.context.transactions.read(lambda uow: uow.jobs.find(TENANT)).result()
    assert (job.state, job.failure_code) == ("DONE", None)
