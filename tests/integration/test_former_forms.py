"""Blobs of a form that is no longer read: what asks for them says so by name, and how they are mended; work goes on."""

from __future__ import annotations

from dataclasses import replace

import pytest

from revisit.core.errors import FormerForm, RevisitError
from revisit.service.adapters.core_recogniser import CoreRecogniser
from revisit.service.domain.identity import SubmapKey
from revisit.service.features.catalogue.downloads import DownloadKind
from revisit.service.features.ingest.clouds import unpack_cloud
from revisit.service.features.resources.paging import PageRequest
from revisit.service.ports.blobs import NEURAL_MAP_BLOB, PLACE_BLOB
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.service_world import SESSION, TENANT, answered, described, sqlite_world, submap

A = SubmapKey(SESSION.map_id, SESSION.session_id, "a")
MENDED = "`revisit reembed MAP`"


class Reading(FakeRecogniser):
    """Describes as the fake does, and reads places and neural maps as the method does."""

    method = CoreRecogniser()

    def verify(self, query, match, similarity, config, initial=None):
        return self.method.verify(match, match, similarity, config, initial)

    def mesh(self, neural_map, config):
        return self.method.mesh(neural_map, config)


@pytest.fixture
async def world(tmp_path):
    """Submap a is described; its place and its neural map are of former forms."""
    world = sqlite_world(tmp_path)
    await described(world, a=1)
    world.context.transactions.write(lambda uow: _make_former(uow, world.context.blobs)).result()
    yield world
    world.context.transactions.close()


def _make_former(uow, blobs) -> None:
    row = uow.submaps.get(TENANT, *vars(A).values())
    place = blobs.put(TENANT, PLACE_BLOB, b"RVPS\x03 and so on")
    neural_map = blobs.put(TENANT, NEURAL_MAP_BLOB, b"RVNM\x03 and so on")
    uow.submaps.replace(replace(row, place_sha256=place, neural_map_sha256=neural_map))


async def test_a_candidate_whose_place_is_of_a_former_form_is_rejected_with_the_reason(world):
    for submap_id, elsewhere in (("b", 2), ("c", 1)):
        await world.use_cases.posting.post(TENANT, submap(submap_id, elsewhere))
    assert world.work_off(Reading()) == 2
    (loop,) = world.context.transactions.read(lambda uow: uow.loops.find(TENANT, map_id=SESSION.map_id)).result()
    assert loop.reason == "PLACE_LOST" and MENDED in loop.evidence["message"]
    rows = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT, map_id=SESSION.map_id)).result()
    assert [row.state for row in rows] == ["DESCRIBED"] * 3


async def test_the_mesh_of_a_map_of_a_former_form_is_refused_by_name_and_the_worker_goes_on(world):
    asked = world.use_cases.submaps.download(TENANT, A, DownloadKind.MESH, None)
    with pytest.raises(RevisitError, match=MENDED) as refused:
        await answered(world, asked, Reading())
    assert refused.value.code == "DATA_LOSS"
    listed = (await world.use_cases.operations.list(TENANT, PageRequest())).items
    assert [one.state for one in listed if one.kind == "MAKE_MESH"] == ["FAILED"]
    await world.use_cases.posting.post(TENANT, submap("c", 3))
    assert world.work_off(Reading()) == 1


def test_a_stored_cloud_of_a_former_form_is_refused_by_name():
    with pytest.raises(FormerForm, match="send it again"):
        unpack_cloud(b"RVQ1" + bytes(20))
