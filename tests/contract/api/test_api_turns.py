"""What costs a lot to answer is done in turns of the tenants, and beside the event loop (P11, P12)."""

from __future__ import annotations

import asyncio
import json
import threading

import httpx
import pytest

from revisit.service.application.access.callers import current_tenant
from revisit.service.application.contract.limits import DESCRIPTOR_LENGTH
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
    turns = world.use_cases.submaps._lists._turns
    async with client_of(app) as client, asyncio.timeout(60):
        async with turns.of("greedy"):
            waiting = [asyncio.create_task(listed(client, keys["greedy"])) for _ in range(MANY)]
            for _ in range(3):  # while these are answered the others have every opportunity
                assert await listed(client, keys["modest"]) == 200
            assert not any(task.done() for task in waiting)
        assert set(await asyncio.gather(*waiting)) == {200}
