"""The client for event loops: the same calls as `Client`, over both transports."""

from __future__ import annotations

import asyncio
from uuid import uuid4

import numpy as np
import pytest

from revisit import AsyncClient, Client
from revisit.sdk import errors
from revisit.sdk.retry import RetryPolicy
from tests.support.service_world import cloud_points, pose

ONCE = RetryPolicy(attempts=1)


@pytest.fixture(params=["rest", "grpc"])
def made(request, service):
    """Makes a client of the running service."""
    if request.param == "rest":
        return lambda: AsyncClient(service.http, retry=ONCE)
    return lambda: AsyncClient.grpc(service.grpc, retry=ONCE)


async def a_session(client):
    """A new session in a map of its own."""
    return await client.sessions.create(await client.maps.create(f"town-{uuid4().hex}"), "monday")


async def test_resources_are_made_read_listed_and_deleted(made):
    async with made() as client:
        town = await client.maps.create("town", display_name="Town")
        assert await client.maps.get("town") == town
        sessions = await asyncio.gather(*(client.sessions.create(town, f"day-{day}") for day in range(5)))
        assert {one.name for one in await client.sessions.list(town)} == {one.name for one in sessions}
        await client.delete(town)
        with pytest.raises(errors.NotFound):
            await client.maps.get("town")


async def test_an_operation_is_waited_for_while_other_calls_go_on(made):
    async with made() as client:
        session = await a_session(client)
        posted = await client.submaps.post(session, "a", cloud_points(1), np.eye(4), 1)
        done, status = await asyncio.gather(client.operations.wait(posted), client.status())
        assert (done.state, done.subject) == ("DONE", f"{session.name}/submaps/a")
        assert status.version


async def test_a_watch_gives_the_events_of_a_map_and_is_left(made):
    async with made() as client:
        session = await a_session(client)
        posted = await client.submaps.post(session, "a", cloud_points(1), np.eye(4), 1)
        await client.operations.wait(posted)
        async for event in client.watch(session.name.partition("/sessions")[0], after=0, kinds=["OPERATION"]):
            assert event.operation is not None and event.operation.name == posted.name
            break


async def test_a_stream_has_every_scan_acknowledged_when_it_is_left(made):
    async with made() as client:
        session = await a_session(client)
        async with client.stream(session) as stream:
            for number in range(1, 4):
                await stream.send(cloud_points(number), pose(5.0 * number), 100 * number)
        assert (await client.sessions.get(session.name)).committed_seq == stream.committed_seq == 3


def test_its_groups_and_calls_are_those_of_the_client(service):
    with Client(service.http) as client:
        groups = client.groups
    assert set(groups) == {
        "maps", "robots", "sessions", "submaps", "loops", "versions", "files", "operations", "webhooks", "plans",
    }  # fmt: skip
    awaited = AsyncClient(service.http)
    for name, group in groups.items():
        calls = [call for call in dir(group) if not call.startswith("_")]
        assert all(asyncio.iscoroutinefunction(getattr(getattr(awaited, name), call)) for call in calls)
    asyncio.run(awaited.close())
