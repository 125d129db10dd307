"""However many wait for operations of a tenant, or for submaps of a map, one read looks for all of them (P11)."""

from __future__ import annotations

import asyncio

import pytest

from revisit.core.errors import RevisitError
from revisit.service.domain.errors import NotFound
from revisit.service.features.waiting.shared_poll import SharedPoll

WAITING = 40


class Store:
    """What has not come yet, and what was looked for."""

    def __init__(self):
        self.missing, self.polls, self.failure = set(), [], None

    async def read(self, work):
        return work(self)

    def not_come(self, _uow, key, items):
        self.polls.append((key, items))
        if self.failure is not None:
            raise self.failure
        return self.missing & items


@pytest.fixture
def store():
    return Store()


@pytest.fixture
def polls(store):
    return SharedPoll(store, store.not_come)


async def test_all_that_wait_beside_one_key_are_told_by_one_read(polls, store):
    store.missing = {3, 5}
    come = await asyncio.gather(*(polls.has_come("acme", item, 0.001) for item in range(WAITING)))
    assert [item for item, there in enumerate(come) if not there] == [3, 5]
    assert store.polls == [("acme", frozenset(range(WAITING)))]


async def test_keys_are_looked_for_apart(polls, store):
    await asyncio.gather(*(polls.has_come(tenant, 1, 0.0) for tenant in ("acme", "other", "acme")))
    assert sorted(key for key, _ in store.polls) == ["acme", "other"]


async def test_the_most_impatient_of_them_says_when(polls, store):
    patient = asyncio.create_task(polls.has_come("acme", 1, 3600.0))
    await asyncio.sleep(0)
    assert await polls.has_come("acme", 2, 0.0)
    assert await patient
    assert len(store.polls) == 1


async def test_what_looking_raises_is_told_to_all_and_the_next_look_is_another(polls, store):
    store.failure = NotFound("the map is gone")
    told = await asyncio.gather(*(polls.has_come("acme", item, 0.0) for item in range(3)), return_exceptions=True)
    assert [type(error) for error in told] == [NotFound] * 3 and isinstance(told[0], RevisitError)
    store.failure = None
    assert await polls.has_come("acme", 1, 0.0)


async def test_who_goes_away_leaves_the_others_waiting(polls, store):
    one, other = (asyncio.create_task(polls.has_come("acme", item, 0.001)) for item in range(2))
    await asyncio.sleep(0)
    one.cancel()
    assert await other
    assert one.cancelled()


def test_it_works_on_the_loop_of_the_gateway_too():
    uvloop = pytest.importorskip("uvloop")

    async def ask():
        store = Store()
        polls = SharedPoll(store, store.not_come)
        return await asyncio.gather(*(polls.has_come("acme", 1, within_s) for within_s in (0.0, 0.0, 0.001)))

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        assert runner.run(ask()) == [True] * 3
