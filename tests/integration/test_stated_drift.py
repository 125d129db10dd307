"""The drift that a session states weighs its steps in the graph of its map."""

from __future__ import annotations

import asyncio

import pytest

from revisit.core.pose_graph.graph import OdometryModel
from revisit.service.domain.identity import SessionKey
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.graph.reading import read_task
from tests.support.service_world import TENANT, memory_world, sqlite_world, submap


@pytest.fixture(params=["memory", "sqlite"])
def world(request, tmp_path):
    made = memory_world() if request.param == "memory" else sqlite_world(tmp_path)
    yield made
    made.context.transactions.close()


async def driven(world, session_id: str, drift: str | None) -> None:
    key = SessionKey("town", session_id)
    await world.use_cases.sessions.create(TENANT, CreateSession("town", session_id, drift=drift))
    await world.use_cases.posting.post(TENANT, submap("p0", 0, key))


def test_a_graph_has_the_drift_that_each_session_states(world):
    stated = {"wheels": "WHEEL", "figures": "0.02 m/m 0.1 deg/m", "silent": None}

    async def drives():
        await world.use_cases.maps.create(TENANT, CreateMap("town"))
        for session_id, drift in stated.items():
            await driven(world, session_id, drift)

    asyncio.run(drives())
    policy = world.context.policy
    task = world.context.transactions.read(lambda uow: read_task(uow, policy, TENANT, "town")).result()
    found = {name: track.odometry for name, track in zip(task.session_ids, task.graph.tracks, strict=True)}
    assert found == {name: OdometryModel.stated(drift) for name, drift in stated.items()}
