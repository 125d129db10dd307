"""What the API answers when all is well, the same over REST and gRPC."""

from __future__ import annotations

import io
from dataclasses import astuple, replace

import numpy as np
import pytest

from revisit import Client
from revisit.core.geometry import se3
from revisit.sdk.errors import AlreadyExists, InvalidArgument, NotFound
from revisit.sdk.resources import LoopPolicy
from tests.support.live_service import connected, live_service
from tests.support.service_world import cloud_points, pose

EXACT = {"rtol": 0, "atol": 1e-12}


def post(client, session, submap_id="a", place=1):
    return client.post_submap(session, submap_id, cloud_points(place), pose(float(place)), 1_000)


def test_a_map_is_read_back_as_it_was_created(client):
    made = client.create_map(f"read-back-{id(client)}", display_name="The yard", tau_m=12.5, leave_distance_m=7)
    assert client.get_map(made.name) == made
    assert (made.display_name, made.tau_m, made.leave_distance_m) == ("The yard", 12.5, 7)
    assert made in client.list_maps()


def test_a_map_has_its_own_rules_for_loops_and_those_of_the_service_for_the_rest(client):
    usual = client.create_map(f"usual-{id(client)}").loop_policy
    own = client.create_map(f"strict-{id(client)}", loop_policy=LoopPolicy(candidates=3, min_score=0.75))
    assert None not in astuple(usual) and usual.min_score != 0.75
    assert own.loop_policy == replace(usual, candidates=3, min_score=0.75)
    assert client.get_map(own.name) == own
    never = client.create_map(f"never-{id(client)}", loop_policy=LoopPolicy(max_seen_through=0.0))
    assert never.loop_policy.max_seen_through == 0.0
    for bad in (LoopPolicy(candidates=0), LoopPolicy(min_overlap=1.01), LoopPolicy(min_score=-0.5)):
        with pytest.raises(InvalidArgument) as refused:
            client.create_map("bad", loop_policy=bad)
        assert refused.value.field.startswith("loop_policy.")


def test_the_same_create_again_answers_again_and_other_content_is_a_conflict(client, session, town):
    assert client.create_session(town, "monday") == session
    map_id = town.removeprefix("maps/")
    with pytest.raises(AlreadyExists) as refused:
        client.create_map(map_id, display_name="another name")
    assert (refused.value.reason, refused.value.retryable) == ("ALREADY_EXISTS", False)


def test_a_session_names_its_robot(client, town):
    robot = client.create_robot(f"rover-{town.removeprefix('maps/')}", display_name="Rover")
    session = client.create_session(town, "with-robot", robot=robot)
    assert session.robot == robot.name
    assert client.get_robot(robot.name) == robot
    assert robot in client.list_robots()


def test_a_posted_submap_is_described_searchable_and_downloadable(client, session, town):
    operation = client.wait(post(client, session))
    assert (operation.state, operation.subject) == ("DONE", f"{session.name}/submaps/a")
    submap = client.get_submap(operation.subject)
    assert (submap.state, submap.point_count, submap.model_version) == ("DESCRIBED", 300, "fake-1")
    np.testing.assert_allclose(submap.T_odom_submap, pose(1.0), **EXACT)
    assert submap.position_m == (1.0, 0.0, 0.0)
    points = np.load(io.BytesIO(client.download(submap, "npy")))
    # Half a millimetre is what the quantised encoding may lose.
    np.testing.assert_allclose(points[:, :3], cloud_points(1), rtol=0, atol=0.00051)
    assert client.download(submap, "pcd").startswith(b"# .PCD")
    for file_format in ("ply", "mesh"):
        assert client.download(submap, file_format).startswith(b"ply\n")
    assert client.download(submap, "neural").startswith(b"neural ")


def test_the_full_view_of_a_submap_has_the_descriptor_to_search_with(client, session, town):
    name = client.wait(post(client, session)).subject
    assert client.get_submap(name).descriptor == ()
    submap = client.get_submap(name, full=True)
    np.testing.assert_array_equal(np.load(io.BytesIO(client.download(name, "descriptor"))), submap.descriptor)
    assert np.linalg.norm(submap.descriptor) == pytest.approx(1.0, abs=1e-5)
    hits = client.search(town, descriptor=submap.descriptor, model_version=submap.model_version)
    assert [(hit.submap, round(hit.similarity, 5)) for hit in hits] == [(name, 1.0)]


def test_a_pose_survives_the_way_there_and_back(client, session):
    T_odom_submap = se3.exp([1.5, -2.0, 0.25, 0.3, -0.2, 2.5])
    operation = client.post_submap(session, "posed", cloud_points(3), T_odom_submap, 2**62)
    submap = client.get_submap(operation.subject)
    np.testing.assert_allclose(submap.T_odom_submap, T_odom_submap, rtol=0, atol=1e-9)
    assert submap.stamp_ns == 2**62


def test_a_submap_finds_its_like_in_another_session(client, session, town):
    client.wait(post(client, session, "a", place=1))
    client.wait(post(client, session, "b", place=2))
    tuesday = client.create_session(town, "tuesday")
    again = client.wait(post(client, tuesday, "again", place=1))

    best = client.search(town, submap=again.subject, k=1)[0]
    assert best.submap == f"{session.name}/submaps/a"
    assert best.similarity == pytest.approx(1.0, abs=1e-6)
    for same_session in (tuesday, tuesday.name, "tuesday"):
        assert client.search(town, submap=again.subject, only_session=same_session) == []
    by_cloud = client.search(town, points=cloud_points(2), k=3, exclude_session=tuesday.name)
    assert by_cloud[0].submap == f"{session.name}/submaps/b"

    (loop,) = client.loop_closures(town, state="ACCEPTED")
    assert (loop.query, loop.match) == (again.subject, f"{session.name}/submaps/a")
    np.testing.assert_allclose(loop.T_match_query, pose(1.0), **EXACT)
    assert client.get_loop_closure(loop.name) == loop
    assert client.loop_closures(town, session=tuesday, state="ACCEPTED") == [loop]
    assert client.loop_closures(town, session=session, state="ACCEPTED") == []
    every = client.loop_closures(town, session=tuesday, state="ALL")
    assert client.loop_closures(town, session="tuesday", state="ALL") == every
    with pytest.raises(NotFound, match="wednesday"):
        client.loop_closures(town, session="wednesday")


def test_a_robot_that_asks_where_it_is_can_leave_out_what_it_has_just_posted(client, session, town):
    client.wait(post(client, session, "a", place=1))
    tuesday = client.create_session(town, "tuesday")
    client.wait(post(client, tuesday, "own", place=1))
    compared = [one.submap for one in client.localize(town, cloud_points(1)).candidates]
    assert f"{tuesday.name}/submaps/own" in compared
    for own in (tuesday, tuesday.name, "tuesday"):
        found = client.localize(town, cloud_points(1), exclude_session=own)
        assert found.session == session.name
        assert [one.submap for one in found.candidates] == [f"{session.name}/submaps/a"]


def test_a_tilted_cloud_is_turned_upright_by_the_pose_that_comes_with_it(client, session, town):
    posted = client.wait(post(client, session, "a", place=1)).subject
    T_level_query = se3.exp([5.0, -3.0, 1.0, 0.4, -1.1, 0.0])
    tilted = cloud_points(1) @ T_level_query[:3, :3]
    assert client.localize(town, tilted).best is None
    found = client.localize(town, tilted, T_level_query=T_level_query)
    assert found.best is not None and found.best.submap == posted
    assert client.search(town, points=tilted)[0].similarity < 0.9
    assert client.search(town, points=tilted, T_level_query=T_level_query)[0].similarity > 0.98
    with pytest.raises(InvalidArgument, match="BAD_FIELD"):
        client.localize(town, tilted, T_level_query=np.diag([2.0, 1.0, 1.0, 1.0]))


def test_a_descriptor_of_the_models_in_use_can_be_searched_for(client, session, town):
    client.wait(post(client, session))
    # The fake recogniser's neural map is its descriptor behind a word.
    vector = np.frombuffer(client.download(f"{session.name}/submaps/a", "neural")[len(b"neural ") :], dtype=np.float32)
    (hit,) = client.search(town, descriptor=vector.tolist(), model_version="fake-1")
    assert hit.similarity == pytest.approx(1.0, abs=1e-6)


def test_a_cloud_is_localised_in_the_map_it_was_taken_in(client, session, town):
    client.wait(post(client, session, place=1))
    found = client.localize(town, cloud_points(1))
    assert found.best is not None
    assert found.best.submap == f"{session.name}/submaps/a"
    assert found.session == session.name
    # The fake recogniser aligns with 1 m along x; the submap stands at 1 m.
    np.testing.assert_allclose(found.T_odom_query, pose(2.0), **EXACT)


def test_an_unknown_place_is_an_answer_and_no_error(client, session, town):
    client.wait(post(client, session, place=1))
    lost = client.localize(town, cloud_points(2))
    assert (lost.best, lost.T_odom_query, lost.session) == (None, None, None)
    assert {candidate.reason for candidate in lost.candidates} == {"LOW_OVERLAP"}
    assert client.localize(client.create_map(f"{town[5:]}-empty"), cloud_points(2)).candidates == ()
    assert client.search(f"{town}-empty", points=cloud_points(2)) == []


@pytest.mark.parametrize("transport", ["rest", "grpc"])
def test_submaps_and_operations_are_listed_over_pages(transport):
    with live_service() as fresh, connected(fresh, transport) as client:
        session = client.create_session(client.create_map("town"), "monday")
        names = [post(client, session, f"s{number:03}", place=number).subject for number in range(60)]
        assert [submap.name for submap in client.list_submaps(session)] == names
        assert {operation.subject for operation in client.list_operations()} == set(names)


def test_a_deleted_submap_and_a_deleted_map_are_gone(client, session, town):
    client.wait(post(client, session))
    client.delete(f"{session.name}/submaps/a")
    with pytest.raises(NotFound):
        client.get_submap(f"{session.name}/submaps/a")
    assert client.search(town, points=cloud_points(1)) == []
    client.delete(town)
    with pytest.raises(NotFound):
        client.get_session(session.name)


def test_the_status_tells_where_grpc_is_and_a_client_of_the_http_address_finds_it(client, service):
    assert client.status().grpc_address == f":{service.grpc.rpartition(':')[2]}"
    with Client.grpc(http=service.http) as found:
        assert found.status().version == "test"


def test_the_status_tells_version_and_queue(client, session):
    status = client.status()
    assert status.version == "test"
    assert min(status.queued_jobs, status.running_jobs, status.failed_jobs) >= 0
