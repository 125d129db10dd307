"""However many watch, the log of events is looked at once, and who watches a silent map is not woken (P11)."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from revisit.service.domain.errors import NotFound
from revisit.service.domain.events import EventRecord
from revisit.service.features.waiting.event_tail import EventTail
from tests.support.records import a_map
from tests.support.service_world import memory_world

WATCHES = 30


class CountedLooks:
    """A store whose looks are let go one by one."""

    def __init__(self, storage):
        self.asked, self._done, self._storage, self._go = 0, 0, storage, asyncio.Semaphore(0)

    async def read(self, work):
        self.asked += 1
        await self._go.acquire()
        answer = await self._storage.read(work)
        self._done += 1
        return answer

    async def look(self, times=1):
        """So many looks; whoever waits has seen them afterwards."""
        for _ in range(times):
            before = self._done
            self._go.release()
            while self._done == before:
                await asyncio.sleep(0)
        for _ in range(10):
            await asyncio.sleep(0)


@pytest.fixture
def world():
    made = memory_world()
    for map_id, tenant in (("town", "acme"), ("yard", "acme"), ("town", "other")):
        made.context.transactions.write(lambda uow, of=(map_id, tenant): uow.maps.add(a_map(*of))).result()
    return made


@pytest.fixture
def store(world):
    return CountedLooks(world.context.storage)


@pytest.fixture
def tail(store):
    return EventTail(store, SimpleNamespace(stopping=False), every_s=0.0)


def note(world, map_id, tenant="acme"):
    world.context.transactions.write(
        lambda uow: uow.events.record(EventRecord(tenant, map_id, "OPERATION", "x"))
    ).result()


async def watching(tail, world, *map_ids, tenant="acme"):
    """Watches that have read as far as the log goes."""
    keys = [(tenant, map_id) for map_id in map_ids]
    seen = world.context.transactions.read(lambda uow: uow.events.last_numbers(keys)).result()
    calls = [asyncio.create_task(tail.beyond(*key, seen[key], 3600.0)) for key in keys]
    await asyncio.sleep(0)
    return calls


async def test_many_who_watch_cause_one_look_at_a_time(tail, store, world):
    begun = await watching(tail, world, *["town"] * WATCHES)
    note(world, "town")
    await store.look()
    assert store.asked == 1
    assert await asyncio.gather(*begun) == [1] * WATCHES
    begun = await watching(tail, world, *["town"] * WATCHES)
    await store.look(times=4)
    assert not any(watch.done() for watch in begun)
    assert store.asked == 1 + 4 + 1  # the last one has been asked for and waits
    for watch in begun:
        watch.cancel()


async def test_only_who_watches_the_map_is_woken(tail, store, world):
    town, yard = await watching(tail, world, "town", "yard")
    (others,) = await watching(tail, world, "town", tenant="other")
    note(world, "town")
    await store.look(times=2)
    assert (town.done(), yard.done(), others.done()) == (True, False, False)
    for watch in (yard, others):
        watch.cancel()


async def test_who_comes_during_a_look_that_does_not_ask_for_its_map_waits_for_the_next(tail, store, world):
    (town,) = await watching(tail, world, "town")
    await asyncio.sleep(0)  # the look is under way
    (yard,) = await watching(tail, world, "yard")
    note(world, "yard")
    await store.look(times=2)
    assert (await yard, town.done()) == (1, False)
    town.cancel()


async def test_who_waits_looks_again_after_a_while_and_when_the_service_stops(store):
    admission = SimpleNamespace(stopping=False)
    tail = EventTail(store, admission, every_s=0.0)
    waiting = asyncio.create_task(tail.beyond("acme", "town", 5, 0.0))
    await store.look()
    assert await waiting <= 5
    admission.stopping = True
    assert await tail.beyond("acme", "town", 5) <= 5


async def test_the_watch_of_a_map_that_is_deleted_ends(tail, store, world):
    (town,) = await watching(tail, world, "town")
    world.context.transactions.write(lambda uow: uow.maps.delete("acme", map_id="town")).result()
    await store.look()
    with pytest.raises(NotFound):
        await town
