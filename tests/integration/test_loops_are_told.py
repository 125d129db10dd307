"""A watch of loop closures tells each one as it is accepted, in whatever order transactions end."""

from __future__ import annotations

import asyncio
import threading
from dataclasses import replace

import pytest

from revisit.service.engines.postgres.transactions import PostgresTransactions
from tests.support.records import TENANT, a_loop, a_map, a_session, a_submap
from tests.support.service_world import memory_world, postgres_world, sqlite_world
from tests.support.stepped_clock import SteppedClock

PATIENT_S = 30.0


@pytest.fixture(params=["memory", "sqlite", "postgres"])
def world(request, tmp_path):
    if request.param == "postgres":
        request.getfixturevalue("postgres_url")
    made = {"memory": memory_world, "sqlite": lambda: sqlite_world(tmp_path), "postgres": postgres_world}
    world = made[request.param]()
    yield world
    world.context.transactions.close()


def fill(uow):
    """A map with a session of four submaps; their numbers."""
    uow.maps.add(a_map())
    uow.sessions.add(a_session())
    return [uow.submaps.add(a_submap(name, ordinal=at)).number for at, name in enumerate("abcd")]


class Watch:
    """A watch of a map, as a client has it."""

    def __init__(self, world, after: int = 0) -> None:
        self._told = world.use_cases.loops.watch(TENANT, "town", after)

    async def next(self):
        return await asyncio.wait_for(anext(self._told), PATIENT_S)


async def test_a_loop_that_is_accepted_later_than_others_is_told_then(world):
    write = world.context.storage.write
    a, b, c, d = await write(fill)
    first = await write(lambda uow: uow.loops.add(replace(a_loop(b, a), state="REJECTED", reason="AMBIGUOUS")))
    await write(lambda uow: uow.loops.add_all([a_loop(c, a), a_loop(d, b)]))
    watch = Watch(world)
    told = [await watch.next(), await watch.next()]
    await write(lambda uow: uow.loops.replace(replace(first, state="ACCEPTED", reason=None)))
    told.append(await watch.next())
    assert [one.loop_id for one in told] == [f"loop-{c}-{a}", f"loop-{d}-{b}", f"loop-{b}-{a}"]
    resumed = Watch(world, after=told[1].seq)
    assert (await resumed.next()).loop_id == f"loop-{b}-{a}"


async def test_a_loop_whose_transaction_began_first_and_ended_last_is_told(postgres_url):
    world = postgres_world()
    write = world.context.storage.write
    a, b, c, d = await write(fill)
    late = PostgresTransactions(world.context.transactions._writer.url, clock=SteppedClock())
    begun, may_end = threading.Event(), threading.Event()

    def slow(uow):
        uow.loops.add(a_loop(b, a))
        begun.set()
        assert may_end.wait(PATIENT_S)

    ended = late.write(slow)
    await asyncio.to_thread(begun.wait, PATIENT_S)
    await write(lambda uow: uow.loops.add(a_loop(d, c)))
    watch = Watch(world)
    assert (await watch.next()).loop_id == f"loop-{d}-{c}"
    may_end.set()
    await asyncio.wrap_future(ended)
    assert (await watch.next()).loop_id == f"loop-{b}-{a}"
    for store in (late, world.context.transactions):
        store.close()
