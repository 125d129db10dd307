"""A map may be in the form of the paper: said once, used for all that is described, never mixed."""

from __future__ import annotations

import dataclasses
import itertools

import pytest

from revisit.core.config import Field, Profile
from revisit.core.errors import DescriptorModelMismatch, MissingLibrary
from revisit.sdk.errors import ApiError, InvalidArgument
from revisit.service.domain.identity import SubmapKey, content_hash
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.index.answers import SearchCriteria
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.service_world import SESSION, TENANT, memory_world, submap

_numbers = itertools.count(1)


class SeenFields(FakeRecogniser):
    """Remembers the profile and the field that it was asked for."""

    def __init__(self):
        self.seen = []

    def describe(self, submap, config):
        self.seen.append((config.profile, config.implicit_map.field))
        return super().describe(submap, config)


class WithoutTorch(FakeRecogniser):
    """Lacks what the paper's form takes."""

    def describe(self, submap, config):
        if config.profile is Profile.PAPER:
            raise MissingLibrary("torch is not installed: pip install 'revisit-loops[learned]'", name="torch")
        return super().describe(submap, config)


@pytest.fixture
async def world():
    made = memory_world()
    await made.use_cases.maps.create(TENANT, CreateMap(SESSION.map_id, profile="paper"))
    await made.use_cases.sessions.create(TENANT, CreateSession(SESSION.map_id, SESSION.session_id))
    yield made
    made.context.transactions.close()


def test_a_map_is_created_in_a_profile_and_shows_it(client):
    map_id = f"paper-{next(_numbers)}"
    created = client.create_map(map_id, profile="paper")
    assert created.profile == client.get_map(created.name).profile == "paper"
    assert {one.name: one.profile for one in client.list_maps()}[created.name] == "paper"
    for number, named in enumerate((None, "product")):
        assert client.create_map(f"{map_id}-{number}", profile=named).profile == "product"


def test_a_repeated_create_in_another_profile_is_a_conflict(client):
    map_id = f"paper-{next(_numbers)}"
    client.create_map(map_id, profile="paper")
    assert client.create_map(map_id, profile="paper").profile == "paper"
    with pytest.raises(ApiError) as refused:
        client.create_map(map_id)
    assert refused.value.reason == "ALREADY_EXISTS"


@pytest.mark.parametrize("profile", ["PAPER", "thesis", " paper"])
def test_an_unknown_profile_is_refused(client, profile):
    with pytest.raises(InvalidArgument) as refused:
        client.create_map(f"paper-{next(_numbers)}", profile=profile)
    assert refused.value.reason == "BAD_FIELD" and "profile" in str(refused.value)


def test_maps_of_different_profiles_are_not_merged(client):
    number = next(_numbers)
    paper, product = client.create_map(f"p-{number}", profile="paper"), client.create_map(f"q-{number}")
    for one, other in ((paper, product), (product, paper)):
        with pytest.raises(InvalidArgument, match="different profiles"):
            client.merge_map(one, other)


async def test_a_create_of_before_there_were_profiles_can_still_be_repeated(world):
    await world.use_cases.maps.create(TENANT, CreateMap("street", tau_m=10.0))
    stored = world.context.transactions.read(lambda uow: uow.maps.get(TENANT, "street")).result()
    assert stored.content_hash == content_hash(("", 10.0, None, None))


async def test_submaps_are_described_in_the_profile_of_their_map_by_its_models(world):
    recogniser = SeenFields()
    await world.use_cases.posting.post(TENANT, submap("a", place=1))
    await world.use_cases.sessions.create(TENANT, CreateSession(SESSION.map_id, "tuesday"))
    again = dataclasses.replace(submap("b", place=1), key=SubmapKey(SESSION.map_id, "tuesday", "b"))
    await world.use_cases.posting.post(TENANT, again)
    world.work_off(recogniser)
    assert recogniser.seen == 2 * [(Profile.PAPER, Field.LEARNED)]
    (loop,) = world.context.transactions.read(lambda uow: uow.loops.find(TENANT)).result()
    assert loop.state == "ACCEPTED" and loop.evidence["model_version"] == "fake-1-paper"


async def test_descriptors_of_another_profile_are_not_compared(world):
    await world.use_cases.posting.post(TENANT, submap("a", place=1))
    world.work_off()
    found = await world.use_cases.submaps.get(TENANT, SubmapKey(SESSION.map_id, SESSION.session_id, "a"), full=True)
    assert found.model_version == "fake-1-paper"
    with pytest.raises(DescriptorModelMismatch):
        await world.use_cases.searches.by_descriptor(
            TENANT, SESSION.map_id, found.place_descriptor, "fake-1", SearchCriteria()
        )


async def test_a_worker_without_torch_says_which_extra_it_lacks_and_the_job_waits_for_somebody(world):
    posted = await world.use_cases.posting.post(TENANT, submap("a", place=1))
    assert world.work_off(WithoutTorch()) == 1
    failed = await world.use_cases.operations.get(TENANT, posted.operation.operation_id)
    assert (failed.state, failed.failure_code) == ("FAILED", "EXTRA_MISSING")
    assert "revisit-loops[learned]" in failed.failure_message
    assert world.work_off() == 0
    await world.use_cases.dead_letters.retry(TENANT, posted.operation.operation_id)
    assert world.work_off() == 1
    found = await world.use_cases.submaps.get(TENANT, SubmapKey(SESSION.map_id, SESSION.session_id, "a"))
    assert found.state == "DESCRIBED" and found.failure_code is None
