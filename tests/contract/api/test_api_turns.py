"""What costs a lot to answer is done in turns of the tenants, and beside the event loop (P11, P12)."""

from __future__ import annotations

import asyncio
import json
import threading

import httpx
import pytest

from revisit.service.domain.callers import current_tenant
from revisit.service.domain.limits import DESCRIPTOR_LENGTH
from revisit.service.features.events import calls as events
from revisit.service.features.loops import keypoints as loop_keypoints
from revisit.service.rest import bodies
from revisit.service.rest.app import create_app
from tests.support.credentials import a_key, bearer
from tests.support.service_world import SESSION, memory_world, open_session

SEARCH = f"/v1/maps/{SESSION.map_id}/submaps:search"
MANY = 40


@pytest.fixture(scope="module")
def world():
    made = memory_world()
    for tenant in ("greedy", "modest"):
        asyncio.run(open_session(made, SESSION, tenant))
    return made


@pytest.fixture(scope="module")
def keys(world):
    return {tenant: bearer(a_key(world, tenant)) for tenant in ("greedy", "modest")}


@pytest.fixture
def app(world):
    return create_app(world.use_cases)


def client_of(app):
    return httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost", timeout=60)


def long_json():
    """The longest descriptor, which fits no index."""
    return json.dumps({"descriptor": [0.12345678901234567] * int(DESCRIPTOR_LENGTH.most)}).encode()


def search(client, key):
    return client.post(SEARCH, content=long_json(), headers={**key, "content-type": "application/json"})


async def listed(client, key):
    """The status of a list, over its session."""
    path = f"/v1/maps/{SESSION.map_id}/sessions/{SESSION.session_id}/submaps?page_size=500"
    return (await client.get(path, headers=key)).status_code


async def test_long_json_is_parsed_beside_the_event_loop_and_one_of_a_tenant_at_a_time(app, keys, monkeypatch):
    parsed, may_go_on, parse = [], threading.Event(), bodies.parse_json

    def parse_json(data, *others):
        on_the_loop = threading.current_thread() is threading.main_thread()
        parsed.append((current_tenant(), on_the_loop))
        if not on_the_loop:
            may_go_on.wait(60)
        return parse(data, *others)

    monkeypatch.setattr(bodies, "parse_json", parse_json)
    async with client_of(app) as client, asyncio.timeout(60):
        searches = [asyncio.create_task(search(client, keys["greedy"])) for _ in range(MANY)]
        while not parsed:
            await asyncio.sleep(0)
        searches.append(asyncio.create_task(search(client, keys["modest"])))
        while len(parsed) < 2:
            await asyncio.sleep(0)
        began = list(parsed)
        may_go_on.set()
        assert began == [("greedy", False), ("modest", False)]
        answers = await asyncio.gather(*searches)
    assert {answer.status_code for answer in answers} == {422}
    assert len(parsed) == MANY + 1


async def test_of_many_lists_of_a_tenant_one_is_read_at_a_time_and_others_go_between(app, world, keys):
    turns = world.use_cases.submaps._context.lists._turns
    async with client_of(app) as client, asyncio.timeout(60):
        async with turns.of("greedy"):
            waiting = [asyncio.create_task(listed(client, keys["greedy"])) for _ in range(MANY)]
            for _ in range(3):  # while these are answered the others have every opportunity
                assert await listed(client, keys["modest"]) == 200
            assert not any(task.done() for task in waiting)
        assert set(await asyncio.gather(*waiting)) == {200}


async def test_keypoints_are_compared_for_one_tenant_after_the_other(world, monkeypatch):
    compared, may_go_on, reading = [], threading.Event(), world.use_cases.loop_keypoints

    def compare(_blobs, tenant, *_):
        compared.append(tenant)
        may_go_on.wait(60)

    monkeypatch.setattr(loop_keypoints, "_pair", lambda *_, tenant, **__: (tenant, None, None))
    monkeypatch.setattr(loop_keypoints, "_read", compare)
    callers = ["greedy"] * 5 + ["modest"]
    async with asyncio.timeout(60):
        asked = []
        for number, tenant in enumerate(callers):
            asked.append(asyncio.create_task(reading.of(tenant, SESSION.map_id, "loop")))
            while len(compared) + reading._turns.waiting <= number:
                await asyncio.sleep(0)
        may_go_on.set()
        await asyncio.gather(*asked)
    # The first is under way, one of the greedy tenant's may come before: never all of them.
    assert sorted(compared) == callers and compared.index("modest") <= 2


async def test_events_are_caught_up_on_by_one_tenant_after_the_other(world, monkeypatch):
    read, watching, callers = [], world.use_cases.events, ["greedy"] * 5 + ["modest"]

    def told(_uow, tenant, **_):
        read.append(tenant)
        return events.EventPage([], 10**9)

    async def caught_up(tenant):
        async for _ in watching.watch(tenant, SESSION.map_id, 0):
            pass

    monkeypatch.setattr(events, "_last", lambda *_, **__: 1)
    monkeypatch.setattr(events, "_page", told)
    async with asyncio.timeout(60):
        async with watching.turns.of("a third"):
            asked = [asyncio.create_task(caught_up(tenant)) for tenant in callers]
            while watching.turns.waiting < len(callers):
                await asyncio.sleep(0)
        while len(read) < len(callers):
            await asyncio.sleep(0)
    for task in asked:
        task.cancel()
    await asyncio.gather(*asked, return_exceptions=True)
    assert read[:2] == ["greedy", "modest"]
