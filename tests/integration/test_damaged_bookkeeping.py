"""Damage in the rows that a service keeps for itself: a row begins anew, or one map is DATA_LOSS; others go on."""

from __future__ import annotations

import asyncio
import sqlite3
from contextlib import aclosing, closing

import pytest

from revisit.core.errors import DataLoss
from revisit.service.domain.identity import SessionKey
from revisit.service.domain.states import EventKind
from revisit.service.engines.local.sqlite.row_checksums import damaged_rows
from revisit.service.features.operations.claiming import JobClaims
from revisit.service.features.webhooks.calls import CreateWebhook
from tests.support.service_world import SESSION, TENANT, World, open_session, sqlite_world, submap
from tests.support.stored_rows import run

DATABASE = "revisit.db"
NO_TEXT = "CAST(x'ff' AS TEXT)"
OTHER = SessionKey("village", "monday")


@pytest.fixture
def restarted(tmp_path):
    """A service that has described two submaps and has two more waiting, as another process finds it after damage."""
    worlds = []

    async def made(damage: str) -> World:
        before = sqlite_world(tmp_path)
        for session in (SESSION, OTHER):
            await open_session(before, session)
            await before.use_cases.posting.post(TENANT, submap("a", 1, session))
        before.work_off()
        before.context.transactions.write(lambda uow: uow.workers.beat("w9", "m")).result()
        for session in (SESSION, OTHER):
            await before.use_cases.posting.post(TENANT, submap("b", 2, session))
        before.context.transactions.close()
        run(tmp_path / DATABASE, damage)
        worlds.append(sqlite_world(tmp_path))
        return worlds[-1]

    yield made
    for world in worlds:
        world.context.transactions.close()


def worked_off(world: World) -> int:
    """How many jobs a worker gets until none is left."""
    claims = JobClaims(world.context.transactions, world.context.disk, world.context.blob_outage, "w1")
    done = 0
    while (lease := claims.next()) is not None:
        world.worker().run(lease)
        done += 1
    return done


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("started_ms", "'x'"), ("started_ms", NO_TEXT), ("started_ms", "x'01'"), ("ran_ms", NO_TEXT),
        ("lifted_ms", "'x'"), ("lifted_ms", NO_TEXT), ("tenant", NO_TEXT),
    ],
)  # fmt: skip
async def test_damaged_turns_begin_anew_and_jobs_run(restarted, column, value):
    world = await restarted(f"UPDATE worker_turns SET {column} = {value} WHERE rowid = 1")
    assert worked_off(world) == 2
    world.context.transactions.write(lambda uow: uow.queue.release("w1", "the end")).result()


@pytest.mark.parametrize("value", ["'x'", NO_TEXT, "x'01'", "1.5", "offset_ms - 5000000000", "4611686018427387904"])
async def test_time_goes_on_from_the_latest_of_the_store_where_the_row_of_a_boot_is_damaged(restarted, tmp_path, value):
    world = await restarted(f"UPDATE boots SET offset_ms = {value}")
    (seen_ms,) = run(tmp_path / DATABASE, "SELECT max(seen_ms) FROM workers")[0]
    assert worked_off(world) == 2
    now_ms = world.context.transactions.read(lambda uow: uow.now_ms()).result()
    assert seen_ms <= now_ms < seen_ms + 3_600_000


@pytest.mark.parametrize("column", ["worker_id", "model_version", "seen_ms"])
@pytest.mark.parametrize("value", ["'x'", NO_TEXT, "1.5"])
async def test_a_worker_whose_row_is_damaged_hides_no_other(restarted, column, value):
    world = await restarted(f"UPDATE workers SET {column} = {value}")
    store = world.context.transactions
    store.write(lambda uow: uow.workers.beat("w1", "m")).result()
    assert "w1" in {one.worker_id for one in store.read(lambda uow: uow.workers.alive(10_000)).result()}
    assert worked_off(world) == 2


DAMAGED_COUNTERS = [
    f"{column} = {value}"
    for column, value in (
        ("changes", "'x'"), ("changes", "changes - 1"), ("events", "'x'"), ("events", "x'01'"), ("events", NO_TEXT),
        ("events", "1.5"), ("events", "events - 4"), ("submaps", "'x'"), ("submaps", "submaps + 64"),
    )
]  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGED_COUNTERS)
async def test_no_number_of_a_map_is_given_again_where_its_counters_were_damaged(restarted, tmp_path, damage):
    world = await restarted(f"UPDATE map_counters SET {damage} WHERE map_id = 'town'")
    posts = (world.use_cases.posting.post(TENANT, submap("c", 3, session)) for session in (SESSION, OTHER))
    await asyncio.gather(*posts)
    assert worked_off(world) == 4
    for numbers in ("map_id, seq FROM events", "map_number, seq FROM index_changes", "map_id, seq FROM submaps"):
        given = run(tmp_path / DATABASE, f"SELECT {numbers}")
        assert len(given) == len(set(given)), numbers
    (row,) = run(tmp_path / DATABASE, "SELECT changes, events, submaps FROM map_counters WHERE map_id = 'village'")
    assert max(row) < 100
    assert {state for (state,) in run(tmp_path / DATABASE, "SELECT state FROM submaps")} == {"DESCRIBED"}
    with closing(sqlite3.connect(tmp_path / DATABASE)) as connection:
        assert not [name for name in damaged_rows(connection) if name.startswith("map_counters")]


@pytest.mark.parametrize("damage", ["events = 'x'", "events = 1.5", "forgotten = 'x'"])
async def test_whoever_watches_a_map_is_served_again_once_its_damaged_counters_begin_anew(restarted, damage):
    world = await restarted(f"UPDATE map_counters SET {damage} WHERE map_id = 'town'")
    with pytest.raises(DataLoss):
        await operations_of(world, "town", 1)
    assert len(await operations_of(world, "village", 1)) == 1
    assert worked_off(world) == 2
    assert len(set(await operations_of(world, "town", 2))) == 2


async def operations_of(world: World, map_id: str, count: int) -> list[str]:
    """So many operations that ended in a map, as a watch tells them from the beginning."""
    watch = world.use_cases.events.watch(TENANT, map_id, 0, frozenset({EventKind.OPERATION}))
    found: list[str] = []
    async with aclosing(watch):
        async for event in watch:
            found += [event.operation.operation_id] if event and event.operation else []
            if len(found) == count:
                return found
    raise AssertionError(found)


@pytest.mark.parametrize("column", ["tenant", "kind", "sha256", "state", "since_ms"])
async def test_blobs_are_collected_beside_a_damaged_row_of_one(restarted, tmp_path, column):
    world = await restarted("UPDATE map_counters SET checksum = checksum")
    store, others = world.context.transactions, [("cloud", f"{number:064x}") for number in range(3)]
    store.write(lambda uow: uow.blobs.release(TENANT, others)).result()
    run(tmp_path / DATABASE, f"UPDATE unreferenced_blobs SET {column} = {NO_TEXT} WHERE sha256 = '{others[1][1]}'")
    begun = store.write(lambda uow: uow.blobs.begin(0, 10)).result()
    assert {blob.sha256 for blob in begun.blobs.values()} >= {others[0][1], others[2][1]}


async def test_webhooks_of_others_are_told_beside_damaged_counters(restarted, tmp_path):
    world = await restarted("UPDATE map_counters SET checksum = checksum")
    await world.use_cases.webhooks.create(TENANT, CreateWebhook("all", "https://example.org/x"))
    assert worked_off(world) == 2
    run(tmp_path / DATABASE, "UPDATE map_counters SET events = 'x' WHERE map_id = 'town'")
    store = world.context.transactions
    (webhook,) = store.read(lambda uow: uow.webhooks.due(2**62)).result()
    assert set(store.read(lambda uow: uow.webhooks.news(webhook)).result()) == {"village"}


async def test_a_map_with_damaged_counters_can_be_deleted(restarted, tmp_path):
    world = await restarted("UPDATE map_counters SET events = 'x' WHERE map_id = 'town'")
    await world.use_cases.maps.delete(TENANT, SESSION.map_id)
    await world.context.erasure.all()
    assert run(tmp_path / DATABASE, "SELECT map_id FROM maps") == [("village",)]
