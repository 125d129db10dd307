"""However many watch, the log of events is looked at once, and who watches a silent map is not woken (P11)."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from revisit.service.domain.events import EventRecord
from revisit.service.features.waiting import event_tail as glance_module
from revisit.service.features.waiting.event_tail import EventTail
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
    return memory_world()


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


async def watching(tail, *map_ids, tenant="acme"):
    """Watches that have read as far as the log goes."""
    calls = [asyncio.create_task(tail.beyond(tenant, map_id, tail.last, 3600.0)) for map_id in map_ids]
    await asyncio.sleep(0)
    return calls


async def test_many_who_watch_cause_one_look_at_a_time(tail, store, world):
    note(world, "town")
    begun = await watching(tail, *["town"] * WATCHES)
    await store.look()
    assert store.asked == 1
    assert await asyncio.gather(*begun) == [True] * WATCHES
    begun = await watching(tail, *["town"] * WATCHES)
    await store.look(times=4)
    assert not any(watch.done() for watch in begun)
    assert store.asked == 1 + 4 + 1  # the last one has been asked for and waits
    for watch in begun:
        watch.cancel()


async def test_only_who_watches_the_map_is_woken(tail, store, world):
    note(world, "town")
    await asyncio.gather(*await watching(tail, "town"), store.look())
    town, yard, others = (*await watching(tail, "town", "yard"), *await watching(tail, "town", tenant="other"))
    note(world, "town")
    await store.look(times=2)
    assert (town.done(), yard.done(), others.done()) == (True, False, False)
    note(world, "")  # concerns every map of the tenant
    await store.look(times=2)
    assert (yard.done(), others.done()) == (True, False)
    others.cancel()


async def test_who_waits_looks_again_after_a_while_and_when_the_service_stops(store):
    admission = SimpleNamespace(stopping=False)
    tail = EventTail(store, admission, every_s=0.0)
    waiting = asyncio.create_task(tail.beyond("acme", "town", 5, 0.0))
    await store.look()
    assert not await waiting
    admission.stopping = True
    assert not await tail.beyond("acme", "town", 5)


async def test_maps_that_are_no_longer_remembered_are_read_once_more_and_nothing_is_missed(
    tail, store, world, monkeypatch
):
    monkeypatch.setattr(glance_module, "MOST_MAPS", 2)
    note(world, "town")
    await asyncio.gather(*await watching(tail, "town"), store.look())
    waiting = await watching(tail, "town")
    for number in range(3):
        note(world, f"map-{number}")
    await store.look()
    assert await waiting[0]
