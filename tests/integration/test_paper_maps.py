"""Maps in the form of the paper in a running service, by the real method: some seconds of a core a submap."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from revisit import Client
from revisit.area.offline_map import AreaMap
from revisit.core.geometry import se3
from revisit.core.implicit_map import NeuralMap
from revisit.core.profiles import Profile, profile_config, profile_models
from revisit.sdk.errors import ApiError, InvalidArgument, OperationFailed
from revisit.sdk.resources import Submap
from tests.support.block_worlds import along, seen, yard
from tests.support.processes import ServiceProcess

pytestmark = pytest.mark.slow

CORE = "revisit.service.adapters.core_recogniser:load_recogniser"
YARD = yard(4, False)
THERE_AND_BACK = along((-12.0, 0.0), (12.0, 0.0), (12.0, 1.0), (-12.0, 1.0))
ALONG_IT = along((-14.0, -1.0), (14.0, -1.0))
DRIVES = {"paper": (THERE_AND_BACK, "paper"), "sunday": (ALONG_IT, "paper"), "product": (ALONG_IT, "product")}
DESCRIBED_WITHIN_S = 600.0


def driven(client: Client, service: ServiceProcess, map_id: str, poses: list[np.ndarray], profile: str) -> list[Submap]:
    """Stream a drive through the yard into a new map, as the one session `day`; its described submaps."""
    client.create_map(map_id, profile=profile)
    session = client.create_session(f"maps/{map_id}", "day")
    with Client.grpc(service.grpc_target) as robot, robot.stream(session) as stream:
        for seq, (points, T_world_sensor) in enumerate(seen(YARD, poses, seed=len(map_id)), 1):
            stream.send(points, T_world_sensor, stamp_ns=seq * 10**8)
    client.finish_session(session)
    submaps = client.list_submaps(session)
    for submap in submaps:
        client.wait(submap.operation, DESCRIBED_WITHIN_S)
    return client.list_submaps(session)


def libraries(pid: int) -> str:
    """What a process has loaded."""
    return Path(f"/proc/{pid}/maps").read_text()


@pytest.fixture(scope="module")
def service(tmp_path_factory) -> Iterator[ServiceProcess]:
    made = ServiceProcess(tmp_path_factory.mktemp("home"), recogniser=CORE)
    yield made
    made.close()


@pytest.fixture(scope="module")
def client(service) -> Iterator[Client]:
    with Client(service.url) as made:
        yield made


@pytest.fixture(scope="module")
def drives(client, service) -> dict[str, list[Submap]]:
    """The submaps of each map; torch is loaded by the first one in the form of the paper, and by workers alone."""
    product = driven(client, service, "product", *DRIVES["product"])
    assert not any("libtorch" in libraries(pid) for pid in service.worker_pids())
    made = {name: driven(client, service, name, *DRIVES[name]) for name in ("paper", "sunday")}
    assert "libtorch" not in libraries(service.pid)
    assert any("libtorch" in libraries(pid) for pid in service.worker_pids())
    return {"product": product, **made}


def test_every_submap_is_described_by_the_models_of_its_profile(drives):
    for name, submaps in drives.items():
        models = profile_models(Profile(DRIVES[name][1]))
        assert {(one.state, one.model_version) for one in submaps} == {("DESCRIBED", models.version)}


def test_a_drive_that_comes_back_finds_its_loops(client, drives):
    loops = client.loop_closures("maps/paper")
    assert loops and all(loop.query != loop.match for loop in loops)
    where = {one.name: one.T_odom_submap for one in drives["paper"]}
    for loop in loops:
        apart = se3.inverse(loop.T_match_query) @ se3.inverse(where[loop.match]) @ where[loop.query]
        assert np.linalg.norm(apart[:3, 3]) < 0.3


def test_a_submap_is_found_by_its_descriptor_in_maps_of_its_profile_alone(client, drives):
    submap = client.get_submap(drives["paper"][0].name, full=True)
    query = {"descriptor": submap.descriptor, "model_version": submap.model_version}
    assert client.search("maps/paper", **query)[0].submap == submap.name
    with pytest.raises(ApiError, match="DESCRIPTOR_MODEL_MISMATCH"):
        client.search("maps/product", **query)


def test_a_cloud_is_localised(client, drives):
    pose = se3.from_yaw(0.5, (3.0, 0.5, THERE_AND_BACK[0][2, 3]))
    ((points, _),) = seen(YARD, [pose], seed=99)
    found = client.localize("maps/paper", points)
    assert found.best is not None and np.linalg.norm((found.T_odom_query - pose)[:3, 3]) < 0.3


def test_neural_map_and_mesh_are_those_of_a_learned_field(client, drives):
    name = drives["paper"][1].name
    rules, models = profile_config(Profile.PAPER).implicit_map, profile_models(Profile.PAPER)
    stored = NeuralMap.from_blob(client.download(name, "neural"), models.decoder, rules)
    assert stored.decoder is not None and stored.features.shape == (len(stored.points), models.decoder.feature_size)
    assert stored.features.any() and stored.decoder.digest != models.decoder.digest
    assert client.download(name, "mesh").startswith(b"ply")


def test_maps_of_one_profile_are_merged_and_the_merged_map_has_a_surface(client, drives, tmp_path):
    result = client.wait(client.merge_map("maps/paper", "maps/sunday"), DESCRIBED_WITHIN_S).result
    assert result["verdict"] == "MERGED", result
    assert np.linalg.norm(np.reshape(result["T_map_source"], (4, 4))[:3, 3]) < 0.3
    ahead = np.array([[0.0, 0.0, 0.3], [2.0, 0.0, 0.3]])
    assert np.nanmax(np.abs(client.map_distances("maps/paper", ahead).distance_m - 0.3)) < 0.1


def test_a_published_map_localises_without_a_link(client, drives, tmp_path):
    client.wait(client.optimise_map("maps/paper"), DESCRIBED_WITHIN_S)
    client.wait(client.publish_map("maps/paper"), DESCRIBED_WITHIN_S)
    client.download_map_file(client.map_files("maps/paper")[0], tmp_path / "paper.zip")
    pose = se3.from_yaw(-0.4, (-4.0, 0.5, THERE_AND_BACK[0][2, 3]))
    ((points, _),) = seen(YARD, [pose], seed=98)
    with AreaMap.open(tmp_path / "paper.zip") as area:
        found = area.localize(points)
    assert found.best is not None and np.linalg.norm((found.T_odom_query - pose)[:3, 3]) < 0.3


def test_a_map_of_another_profile_is_not_merged(client, drives):
    with pytest.raises(InvalidArgument, match="different profiles"):
        client.merge_map("maps/paper", "maps/product")


def test_a_worker_without_torch_refuses_with_the_extra_and_goes_on_with_maps_of_the_product(tmp_path):
    service = ServiceProcess(tmp_path, recogniser="tests.support.without_torch:load")
    try:
        with Client(service.url) as client:
            with pytest.raises(OperationFailed) as refused:
                driven(client, service, "paper", ALONG_IT[:10], "paper")
            (described, *_) = driven(client, service, "product", ALONG_IT[:10], "product")
            (submap, *_) = client.list_submaps("maps/paper/sessions/day")
    finally:
        service.close()
    assert refused.value.reason == "EXTRA_MISSING" and "pip install 'revisit-loops[learned]'" in str(refused.value)
    assert (submap.state, described.state) == ("FAILED", "DESCRIBED")
