"""A map may be of another scale than a street: given once, used for all that is described, never mixed."""

from __future__ import annotations

import asyncio
import dataclasses
import itertools

import numpy as np
import pytest

from revisit.core.errors import BadField, DescriptorModelMismatch
from revisit.sdk.errors import ApiError
from revisit.service.domain.errors import AlreadyExists
from revisit.service.domain.identity import SubmapKey, content_hash
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.index.answers import SearchCriteria
from revisit.service.features.ingest.clouds import DecodedCloud
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.patience import PATIENCE_S
from tests.support.service_world import SESSION, TENANT, cloud_points, memory_world, submap

_numbers = itertools.count(1)


class SeenScales(FakeRecogniser):
    """Remembers with which scale and nearest range it was asked."""

    def __init__(self):
        self.seen = []

    def describe(self, submap, config):
        self.seen.append((config.scene_scale, config.submap.min_range))
        return super().describe(submap, config)


@pytest.fixture
async def world():
    made = memory_world()
    await made.use_cases.maps.create(TENANT, CreateMap(SESSION.map_id, scene_scale=0.25))
    await made.use_cases.sessions.create(TENANT, CreateSession(SESSION.map_id, SESSION.session_id))
    yield made
    made.context.transactions.close()


def test_a_map_is_created_with_a_scale_and_shows_it(client):
    map_id = f"rooms-{next(_numbers)}"
    created = client.create_map(map_id, scene_scale=0.25)
    assert created.scene_scale == client.get_map(created.name).scene_scale == 0.25
    assert client.create_map(f"street-{next(_numbers)}").scene_scale == 1.0


def test_a_repeated_create_with_another_scale_is_a_conflict(client):
    map_id = f"rooms-{next(_numbers)}"
    client.create_map(map_id, scene_scale=0.25)
    assert client.create_map(map_id, scene_scale=0.25).scene_scale == 0.25
    for other in (None, 0.5):
        with pytest.raises(ApiError) as refused:
            client.create_map(map_id, scene_scale=other)
        assert refused.value.reason == "ALREADY_EXISTS"


@pytest.mark.parametrize(("scale", "taken"), [(0.01, True), (10.0, True), (0.0099, False), (10.01, False)])
def test_a_scale_is_taken_up_to_its_limits(client, scale, taken):
    map_id = f"rooms-{next(_numbers)}"
    if taken:
        assert client.create_map(map_id, scene_scale=scale).scene_scale == scale
        return
    with pytest.raises(ApiError) as refused:
        client.create_map(map_id, scene_scale=scale)
    assert refused.value.reason == "BAD_FIELD"


async def test_a_scale_that_is_no_number_is_refused(world):
    with pytest.raises(BadField):
        await world.use_cases.maps.create(TENANT, CreateMap("nowhere", scene_scale=float("nan")))


async def test_a_create_of_before_there_were_scales_can_still_be_repeated(world):
    first = await world.use_cases.maps.create(TENANT, CreateMap("street", tau_m=10.0))
    stored = world.context.transactions.read(lambda uow: uow.maps.get(TENANT, "street")).result()
    # The first release hashed display name, tau, stride and gap.
    assert stored.content_hash == content_hash(("", 10.0, None, None))
    assert not first.replay and (await world.use_cases.maps.create(TENANT, CreateMap("street", tau_m=10.0))).replay
    with pytest.raises(AlreadyExists):
        await world.use_cases.maps.create(TENANT, CreateMap("street", tau_m=10.0, scene_scale=2.0))


async def test_workers_and_searches_by_cloud_use_the_scale_of_the_map(world):
    recogniser = SeenScales()
    await world.use_cases.posting.post(TENANT, submap("a", place=1))
    world.work_off(recogniser)
    search = world.use_cases.searches.by_cloud(TENANT, SESSION.map_id, DecodedCloud(cloud_points(1)), SearchCriteria())
    answer = asyncio.create_task(search)
    async with asyncio.timeout(PATIENCE_S):
        while world.work_off(recogniser) == 0:
            await asyncio.sleep(0.01)
        assert len((await answer).hits) == 1
    # The range within which returns hit the robot itself shrinks with the scene: a quarter of 1 m.
    assert recogniser.seen == [(0.25, 0.25), (0.25, 0.25)]


async def test_descriptors_of_another_scale_are_not_compared(world):
    await world.use_cases.posting.post(TENANT, submap("a", place=1))
    world.work_off()
    found = await world.use_cases.submaps.get(TENANT, SubmapKey(SESSION.map_id, SESSION.session_id, "a"), full=True)
    assert found.model_version == "fake-1@scale-0.25"
    searches, criteria = world.use_cases.searches, SearchCriteria()
    hits = await searches.by_descriptor(TENANT, SESSION.map_id, found.place_descriptor, found.model_version, criteria)
    assert [hit.submap.submap_id for hit in hits.hits] == ["a"]
    with pytest.raises(DescriptorModelMismatch):
        await searches.by_descriptor(TENANT, SESSION.map_id, found.place_descriptor, "fake-1", criteria)


async def test_a_loop_is_closed_within_a_map_of_another_scale(world):
    await world.use_cases.posting.post(TENANT, submap("a", place=1))
    await world.use_cases.sessions.create(TENANT, CreateSession(SESSION.map_id, "tuesday"))
    again = dataclasses.replace(submap("b", place=1), key=SubmapKey(SESSION.map_id, "tuesday", "b"))
    await world.use_cases.posting.post(TENANT, again)
    world.work_off()
    (loop,) = world.context.transactions.read(lambda uow: uow.loops.find(TENANT)).result()
    assert loop.state == "ACCEPTED" and np.isclose(loop.similarity, 1.0)
    assert loop.evidence["model_version"] == "fake-1@scale-0.25"
