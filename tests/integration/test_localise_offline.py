"""A cloud is judged in a map file as in the service: candidate by candidate, and placed at the same pose."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.area import AreaMap
from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_matrix
from revisit.core.model_bundle import load_packaged_models
from revisit.formats.map_file import FiledSubmap, MapDescription, write_map_file
from revisit.service.adapters.core_recogniser import load_recogniser
from revisit.service.domain.identity import SessionKey, SubmapKey
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.ingest.clouds import DecodedCloud
from revisit.service.features.ingest.posting import PostSubmap
from revisit.service.features.relocalisation.calls import StartConversation
from revisit.service.features.search.calls import LocalizeQuery
from revisit.service.ports.blobs import NEURAL_MAP_BLOB
from tests.support.service_world import TENANT, answered, memory_world
from tests.support.yards import yard

YARDS = {"s0": 0, "s1": 1, "s2": 2, "twin": 0}
"""Sessions of a map, each in a yard; two yards are twins, in frames of their own."""


def points(seed, T_new_old=np.eye(4)):
    """The surfaces of a yard as points, 40 m around."""
    found = se3.apply(T_new_old, yard(seed).vertices).astype(np.float32)
    return found[np.linalg.norm(found, axis=1) < 40.0]


@pytest.fixture(scope="module")
def recogniser():
    return load_recogniser()


@pytest.fixture
async def world(recogniser):
    """The yards in a service, described."""
    made = memory_world(pipeline=PipelineConfig())
    await made.use_cases.maps.create(TENANT, CreateMap("yards"))
    for n, (session, seed) in enumerate(YARDS.items()):
        await made.use_cases.sessions.create(TENANT, CreateSession("yards", session))
        pose = se3.from_yaw(0.0, (100.0 * n, 0.0, 0.0))
        post = PostSubmap(SubmapKey("yards", session, "0"), pose, n, DecodedCloud(points(seed)))
        await made.use_cases.posting.post(TENANT, post)
    made.work_off(recogniser)
    return made


def filed(world, folder):
    """The same submaps as a map file; each session is a frame of its own, since no loop joins two."""
    submaps = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT)).result()
    rows = []
    for one in submaps:
        neural = world.context.blobs.get(TENANT, NEURAL_MAP_BLOB, one.neural_map_sha256)
        pose = pose_matrix(one.T_odom_submap)
        name = SessionKey(one.map_id, one.session_id).name + f"/submaps/{one.submap_id}"
        row = FiledSubmap(
            name, one.ordinal, one.session_number, f"frame-{one.session_number}", pose, pose, one.neural_map_sha256
        )
        rows.append((row, np.frombuffer(one.descriptor, dtype="<f4"), neural))
    config = PipelineConfig().submap
    models = load_packaged_models()
    file = folder / "yards.zip"
    description = MapDescription("yards", "1", "hash", 0, models.version, 1.0, config.tau, config.stride, {})
    write_map_file(file, description, rows)
    return file


@pytest.mark.parametrize("seed", [1, 0, 9], ids=["placed", "twins in two frames", "unknown"])
async def test_a_map_file_judges_a_cloud_as_the_service_does(world, recogniser, tmp_path, seed):
    cloud = points(seed, se3.inverse(se3.from_yaw(1.1, (4.0, -2.0, 0.0))))
    asked = LocalizeQuery("yards", DecodedCloud(cloud), candidates=len(YARDS))
    service = await answered(world, world.use_cases.searches.localize(TENANT, asked), recogniser)
    with AreaMap.open(filed(world, tmp_path)) as area:
        offline = area.localize(cloud, candidates=len(YARDS))
    told = {one.submap.name: (one.accepted, one.reason) for one in service.candidates}
    assert {one.submap: (one.accepted, one.reason) for one in offline.candidates} == told
    assert len(told) == len(YARDS)
    assert (service.best is None) == (offline.best is None) == (seed == 9)
    if service.best is not None:
        assert service.best.submap.name == offline.best.submap
        # The service measures at keypoints, a file at its neural map.
        np.testing.assert_allclose(service.T_odom_query, offline.T_odom_query, atol=0.02)


async def test_a_map_file_holds_the_conversation_that_the_service_holds(world, recogniser, tmp_path):
    """Past a yard of which the map has a twin, into one of which it has none, and out of the map."""
    views = [(0, 0.0), (1, 12.0), (9, 24.0)]
    conversation = await world.use_cases.conversations.begin(TENANT, StartConversation("yards"))
    with AreaMap.open(filed(world, tmp_path)) as area:
        offline = area.relocalise()
        for seed, x_m in views:
            cloud, pose = points(seed, se3.inverse(se3.from_yaw(1.1, (4.0, -2.0, 0.0)))), se3.from_yaw(0.0, (x_m, 0, 0))
            told = offline.see(cloud, pose)
            asked = conversation.see(DecodedCloud(cloud), pose)
            served = (await answered(world, asked, recogniser)).answer
            assert (told.state, told.reason) == (served.state.value, served.reason and served.reason.value)
            assert told.none_of_them == pytest.approx(served.none_of_them, abs=0.02)
            assert len(told.poses) == len(served.poses)
            for one, other in zip(told.poses, served.poses, strict=True):
                np.testing.assert_allclose(one.in_map.T_map, other.T_frame_view, atol=0.03)
                assert one.probability == pytest.approx(other.probability, abs=0.02)
