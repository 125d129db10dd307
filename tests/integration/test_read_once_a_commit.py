"""What is read again only once something was committed is as the store says, whichever process wrote it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from revisit.service.domain.identity import TenantId
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.features.index.answers import SearchCriteria
from revisit.service.features.keys import known_keys
from revisit.service.features.keys.known_keys import KnownKeys
from revisit.service.ports.access import KeyRecord
from revisit.service.ports.storage import Storage
from tests.support.service_world import TENANT, open_session, sqlite_world, submap

KEY = KeyRecord(TenantId("acme"), "abcdefabcdef", "robot 7", ("query",), "0" * 64, 5, None, None)


@pytest.fixture
def world(tmp_path):
    made = sqlite_world(tmp_path)
    yield made
    made.context.transactions.close()


@pytest.fixture
def elsewhere(world):
    """The same database, as another process has it open."""
    store = SqliteTransactions(world.home / "revisit.db", checkpoints=False)
    yield store
    store.close()


@pytest.fixture
def reads(world, monkeypatch):
    """The reads of the world's store so far."""
    done = []
    read_here = world.context.transactions.read_here
    monkeypatch.setattr(world.context.transactions, "read_here", lambda work: (done.append(work), read_here(work))[1])
    return done


def test_a_commit_of_another_process_is_seen_at_once(world, elsewhere):
    before = world.context.transactions.version()
    assert world.context.transactions.version() == before
    elsewhere.write(lambda uow: uow.keys.add(KEY)).result()
    assert world.context.transactions.version() != before


def test_a_closed_store_tells_no_version(world):
    store = SqliteTransactions(world.home / "revisit.db", checkpoints=False)
    assert store.version() is not None
    store.close()
    assert store.version() is None


async def test_a_key_is_read_once_and_again_after_each_commit(world, elsewhere, reads):
    keys = KnownKeys(Storage(world.context.transactions, world.context.blobs))
    assert [await keys.is_empty() for _ in range(3)] == [True] * 3
    assert len(reads) == 1
    added = elsewhere.write(lambda uow: uow.keys.add(KEY)).result()
    assert not await keys.is_empty()
    assert [await keys.get(KEY.key_id) for _ in range(3)] == [added] * 3
    assert len(reads) == 3
    revoked = replace(added, revoked_at_ns=9)
    elsewhere.write(lambda uow: uow.keys.replace(revoked)).result()
    assert await keys.get(KEY.key_id) == revoked


async def test_keys_that_do_not_exist_take_no_memory(world, monkeypatch, reads):
    monkeypatch.setattr(known_keys, "MOST_KNOWN", 2)
    keys = KnownKeys(Storage(world.context.transactions, world.context.blobs))
    assert [await keys.get("000000000000") for _ in range(3)] == [None] * 3
    assert len(reads) == 3
    for number in range(5):
        await world.context.storage.write(lambda uow, n=number: uow.keys.add(replace(KEY, key_id=f"{n:012d}")))
    for number in range(5):
        assert (await keys.get(f"{number:012d}")).key_id == f"{number:012d}"
    assert len(keys._known) <= 2


async def three_places(world):
    """What searches a map of three described submaps, and the key of the first."""
    await open_session(world)
    for number in range(3):
        await world.use_cases.posting.post(TENANT, submap(f"s{number}", number))
    world.work_off()
    return world.use_cases.searches, submap("s0", 0).key


async def test_a_search_knows_what_another_process_described_or_deleted(world, elsewhere, reads):
    searches, key = await three_places(world)

    async def found():
        result = await searches.by_submap(TENANT, key, SearchCriteria())
        return {hit.submap.submap_id for hit in result.hits}

    assert [await found() for _ in range(3)] == [{"s1", "s2"}] * 3
    reads.clear()
    await found()
    assert len(reads) == 1  # what is asked for, and the rows of the hits
    gone = elsewhere.read(lambda uow: uow.submaps.get(TENANT, "town", "monday", "s1")).result()
    elsewhere.write(lambda uow: _removed(uow, gone)).result()
    assert await found() == {"s2"}


async def test_a_search_that_another_one_overtakes_answers_as_that_one_does(world, elsewhere, monkeypatch):
    searches, key = await three_places(world)
    await searches.by_submap(TENANT, key, SearchCriteria())
    caught_up = searches._memory._search
    index = caught_up._index
    compare, gone = index.search, elsewhere.read(lambda uow: uow.submaps.get(TENANT, "town", "monday", "s1")).result()

    def overtaken(number, *asked):
        matches = compare(number, *asked)
        if index.size(number) == 3:
            elsewhere.write(lambda uow: _removed(uow, gone)).result()
            caught_up.catch_up(TENANT, number)
        return matches

    monkeypatch.setattr(index, "search", overtaken)
    result = await searches.by_submap(TENANT, key, SearchCriteria())
    assert [hit.submap.submap_id for hit in result.hits] == ["s2"] and result.searched == 2


def _removed(uow, record):
    uow.submaps.delete(TENANT, number=record.number)
    uow.changes.record_removed(uow.maps.get(TENANT, "town"), [record.number])
