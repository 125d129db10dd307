"""One map out of many sessions, the same over REST and gRPC: versions, corrections, poses. The fleet is simulated."""

from __future__ import annotations

import itertools
import threading

import httpx
import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.sdk.errors import FailedPrecondition, InvalidArgument, NotFound
from tests.support.fleet_in_service import fleet_in, slipped_fleet_in
from tests.support.patience import PATIENCE_S
from tests.support.service_world import cloud_points, pose

SMALL = {"sessions": 2, "submaps": 30, "per_pair": 10}

_numbers = itertools.count(1)


@pytest.fixture
def fleet(service):
    return fleet_in(service.world, f"fleet-{next(_numbers)}", 0.3, **SMALL)


def optimised(client, map_name):
    """The version that an optimisation made."""
    done = client.wait(client.optimise_map(map_name))
    return client.get_map_version(done.result["version"])


def test_a_map_is_optimised_into_a_version_that_tells_what_it_rests_on(client, fleet):
    assert client.get_map(fleet.name).map_version == 0 and client.map_versions(fleet.name) == []
    first = optimised(client, fleet.name)
    assert (first.version, first.in_force, first.restored_from) == (1, True, None)
    assert client.get_map(fleet.name).map_version == 1
    assert client.map_versions(fleet.name) == [first]
    rests = first.summary
    assert (rests.sessions, rests.submaps, rests.frames, rests.mean_change_m) == (2, 60, 1, None)
    states = {loop.name: loop.graph_state for loop in client.loop_closures(fleet.name, state="ALL")}
    assert {name for name, state in states.items() if state == "IN_MAP"} == fleet.right()
    assert rests.loops_in_map == len(fleet.right())
    assert rests.loops_set_aside == len(states) - len(fleet.right()) > 0
    aside = client.loop_closures(fleet.name, graph_state="SET_ASIDE")
    assert {loop.name for loop in aside} == states.keys() - fleet.right()


def test_a_client_that_names_no_state_is_told_no_loop_that_the_map_set_aside(client, fleet):
    accepted = {loop.name for loop in client.loop_closures(fleet.name)}
    assert accepted == {loop.name for loop in client.loop_closures(fleet.name, state="ACCEPTED")} > fleet.right()
    optimised(client, fleet.name)
    assert {loop.name for loop in client.loop_closures(fleet.name)} == fleet.right()
    assert {loop.name for loop in client.loop_closures(fleet.name, state="ACCEPTED")} == accepted


def test_the_same_map_optimised_again_is_the_same_to_a_bit(client, fleet):
    first, second = optimised(client, fleet.name), optimised(client, fleet.name)
    assert second.version == 2 and second.content_hash == first.content_hash
    assert [one.in_force for one in client.map_versions(fleet.name)] == [False, True]
    assert (second.summary.mean_change_m, second.summary.max_change_m) == (0.0, 0.0)


def test_poses_of_a_version_come_page_by_page_and_are_near_the_truth(client, fleet):
    version = optimised(client, fleet.name)
    listed = client.submap_poses(version)
    assert [pose.submap.rpartition("/")[2] for pose in listed] == [f"{n:03d}" for n in range(30)] * 2
    poses = fleet.poses(listed)
    odometry = {one.session: one.T_odom_submap for one in fleet.fleet.graph.trajectories}
    assert fleet.fleet.error_m(poses) < 1.0 < 30.0 < fleet.fleet.error_m(odometry)
    assert all(np.linalg.eigvalsh(pose.covariance).min() > 0.0 for pose in listed)
    assert {pose.frame for pose in listed} == {client.correction(f"{fleet.name}/sessions/s0").frame}


def test_a_slip_of_odometry_is_mended_and_a_finding_of_its_session(service, client):
    fleet = slipped_fleet_in(service.world, f"slipped-{next(_numbers)}")
    sessions = {name: f"{fleet.name}/sessions/{name}" for name in ("s0", "s1")}

    def of_odometry(session):
        return [one for one in client.get_session(session).findings if one.code.startswith("odometry_")]

    assert of_odometry(sessions["s1"]) == []
    version = optimised(client, fleet.name)
    assert (version.summary.loops_in_map, version.summary.loops_set_aside) == (len(fleet.right()), 0)
    assert fleet.fleet.error_m(fleet.poses(client.submap_poses(version))) < 0.5
    (finding,) = of_odometry(sessions["s1"])
    assert finding.code == "odometry_slip"
    assert "between submaps 029 and 030" in finding.cause and "4.9 m" in finding.cause
    assert of_odometry(sessions["s0"]) == []
    fault = finding.odometry_fault
    ends = [f"{sessions['s1']}/submaps/{name}" for name in ("029", "030")]
    assert (fault.session, fault.kind, fault.submaps) == (sessions["s1"], "SLIP", 2)
    assert [fault.first_submap, fault.last_submap] == ends
    assert fault.amount == pytest.approx(4.9, abs=0.2) and 0.0 < fault.sigma < 0.2 and fault.loops > 10


def test_a_fault_of_odometry_is_told_by_version_and_correction(service, client):
    fleet = slipped_fleet_in(service.world, f"slipped-{next(_numbers)}")
    version = optimised(client, fleet.name)
    (fault,) = version.summary.odometry_faults
    assert (fault.kind, fault.session) == ("SLIP", f"{fleet.name}/sessions/s1")
    told = {one: client.correction(f"{fleet.name}/sessions/{one}").odometry_faults for one in ("s0", "s1")}
    assert told == {"s0": (), "s1": (fault,)}
    with client.watch_corrections(fleet.name) as watch:
        streamed = {one.session[-2:]: one.odometry_faults for one in itertools.islice(watch, 2)}
    assert streamed == told
    client.submaps.delete(fault.last_submap)
    (left,) = client.get_map_version(version.name).summary.odometry_faults
    assert (left.first_submap, left.last_submap) == (fault.first_submap, "") and "between" not in left.message
    client.sessions.delete(fault.session)
    assert client.get_map_version(version.name).summary.odometry_faults == ()


def test_a_correction_maps_odometry_into_the_map(client, fleet):
    session = f"{fleet.name}/sessions/s1"
    with pytest.raises(FailedPrecondition) as refused:
        client.correction(session)
    assert refused.value.reason == "NOT_READY"
    version = optimised(client, fleet.name)
    correction = client.correction(session)
    assert (correction.session, correction.map_version) == (session, 1)
    last = client.submap_poses(version)[-1]
    odometry = client.get_submap(last.submap).T_odom_submap
    np.testing.assert_allclose(correction.T_map_odom @ odometry, last.T_map_submap, rtol=0, atol=1e-9)
    np.testing.assert_allclose(correction.covariance, last.covariance)
    anchor = client.correction(f"{fleet.name}/sessions/s0")
    first = client.get_submap(f"{anchor.session}/submaps/000")
    np.testing.assert_allclose(first.in_map.T_map, first.T_odom_submap, rtol=0, atol=1e-3)


def test_submaps_loops_and_hits_tell_where_the_map_has_them(client, fleet):
    before = client.list_submaps(f"{fleet.name}/sessions/s0")
    assert [submap.in_map for submap in before] == [None] * 30
    version = optimised(client, fleet.name)
    poses = {pose.submap: pose for pose in client.submap_poses(version)}
    for submap in client.list_submaps(f"{fleet.name}/sessions/s1"):
        np.testing.assert_allclose(submap.in_map.T_map, poses[submap.name].T_map_submap, rtol=0, atol=1e-12)
        assert (submap.in_map.frame, submap.in_map.map_version) == (poses[submap.name].frame, 1)
    for loop in client.loop_closures(fleet.name, graph_state="IN_MAP"):
        np.testing.assert_allclose(loop.in_map.T_map, poses[loop.query].T_map_submap, rtol=0, atol=1e-12)
        np.testing.assert_allclose(loop.T_map_match, poses[loop.match].T_map_submap, rtol=0, atol=1e-12)
        gap = se3.inverse(loop.T_map_match @ loop.T_match_query) @ loop.in_map.T_map
        assert np.linalg.norm(gap[:3, 3]) < 1.0


def test_what_comes_after_a_version_lies_where_its_sessions_correction_says(client, session, town):
    for number, place in enumerate((1, 2, 1)):
        client.wait(client.post_submap(session, f"early-{number}", cloud_points(place), pose(float(number)), 1))
    correction_of_version = optimised(client, town)
    late = client.post_submap(session, "late", cloud_points(5), pose(9.0), 1_000)
    client.wait(late)
    correction = client.correction(session)
    expected = correction.T_map_odom @ pose(9.0)
    found = client.get_submap(f"{session.name}/submaps/late").in_map
    np.testing.assert_allclose(found.T_map, expected, rtol=0, atol=1e-12)
    assert found.map_version == correction_of_version.version
    for hits in (
        client.search(town, points=cloud_points(5), k=1),
        client.search(town, submap=f"{session.name}/submaps/early-1", k=100),
    ):
        late_hit = next(hit for hit in hits if hit.submap.endswith("/late"))
        np.testing.assert_allclose(late_hit.in_map.T_map, expected, rtol=0, atol=1e-12)
    located = client.localize(town, cloud_points(5))
    np.testing.assert_allclose(located.in_map.T_map, expected @ located.best.T_match_query, rtol=0, atol=1e-12)
    assert located.in_map.frame == correction.frame


def test_sessions_that_nothing_joins_have_frames_of_their_own(client, town):
    for name in ("east", "west"):
        client.wait(client.post_submap(client.create_session(town, name), "a", cloud_points(len(name)), pose(3.0), 1))
    version = optimised(client, town)
    assert version.summary.frames == 2
    corrections = [client.correction(f"{town}/sessions/{name}") for name in ("east", "west")]
    assert corrections[0].frame != corrections[1].frame
    for correction in corrections:
        np.testing.assert_allclose(correction.T_map_odom, np.eye(4), rtol=0, atol=1e-6)


def test_corrections_are_watched_as_versions_come(client, fleet):
    optimised(client, fleet.name)
    told, enough = [], threading.Event()

    def hear(correction):
        told.append(correction)
        if len(told) == 4:
            enough.set()

    with client.watch_corrections(fleet.name).call(hear):
        while len(told) < 2:
            assert not enough.wait(0.05)
        optimised(client, fleet.name)
        assert enough.wait(PATIENCE_S)
    sessions = [f"{fleet.name}/sessions/s{n}" for n in (0, 1)]
    assert [(one.session, one.map_version) for one in told] == [(name, v) for v in (1, 2) for name in sessions]
    with client.watch_corrections(fleet.name, session="s1", after=1) as watch:
        assert next(iter(watch)).session == sessions[1]


def test_an_earlier_version_comes_back_to_a_bit_and_with_it_the_verdicts_on_loops(client, service, fleet):
    first = optimised(client, fleet.name)
    poses = client.submap_poses(first)
    verdicts = {loop.name: loop.graph_state for loop in client.loop_closures(fleet.name, state="ALL")}
    client.delete(f"{fleet.name}/sessions/s1/submaps/029")
    wrong = next(name for name in verdicts if "wrong" in name)
    second = optimised(client, fleet.name)
    assert second.content_hash != first.content_hash
    first_now = client.get_map_version(first.name)
    restored = client.revert_map(fleet.name, first.version)
    assert (restored.version, restored.restored_from, restored.in_force) == (3, 1, True)
    assert restored.content_hash == first_now.content_hash
    again = {pose.submap: pose for pose in client.submap_poses(restored)}
    for pose_before in poses[:-1]:
        assert again[pose_before.submap].T_map_submap.tobytes() == pose_before.T_map_submap.tobytes()
    now = {loop.name: loop.graph_state for loop in client.loop_closures(fleet.name, state="ALL")}
    assert now == {name: verdicts[name] for name in now}
    assert now.get(wrong, "SET_ASIDE") == "SET_ASIDE"
    assert client.revert_map(fleet.name, 3) == client.get_map_version(restored.name)


def test_what_is_no_version_is_refused(client, fleet):
    optimised(client, fleet.name)
    for version in (2, 2**63 - 1):
        with pytest.raises(NotFound):
            client.revert_map(fleet.name, version)
    with pytest.raises(InvalidArgument):
        client.revert_map(fleet.name, 0)
    with pytest.raises(InvalidArgument):
        client.get_map_version(f"{fleet.name}/versions/first")
    with pytest.raises(NotFound):
        client.submap_poses(f"{fleet.name}/versions/7")


@pytest.mark.parametrize("version", ["first", "-1", "9223372036854775808", "*"])
def test_a_path_with_a_version_that_is_no_number_is_refused_by_the_name_of_the_version(service, fleet, version):
    answer = httpx.get(f"{service.http}/v1/{fleet.name}/versions/{version}", trust_env=False)
    assert (answer.status_code, answer.json()["reason"], answer.json()["field"]) == (422, "BAD_FIELD", "version")


def test_an_asterisk_in_a_path_is_an_id_like_any_other(service, fleet):
    answer = httpx.get(f"{service.http}/v1/maps/*/versions/1", trust_env=False)
    assert (answer.status_code, answer.json()["reason"]) == (404, "NOT_FOUND")


def test_a_deleted_session_is_gone_from_every_version(client, fleet):
    first = optimised(client, fleet.name)
    client.delete(f"{fleet.name}/sessions/s1")
    assert {pose.submap.split("/")[3] for pose in client.submap_poses(first)} == {"s0"}
    assert client.get_map_version(first.name).content_hash != first.content_hash
    second = optimised(client, fleet.name)
    assert (second.summary.sessions, second.summary.frames, second.summary.loops_in_map) == (1, 1, 0)
    client.delete(fleet.name)
    with pytest.raises(NotFound):
        client.map_versions(fleet.name)


def test_an_optimisation_that_waits_is_answered_again(client, service, fleet):
    service.working.clear()
    try:
        first, second = client.optimise_map(fleet.name), client.optimise_map(fleet.name)
    finally:
        service.working.set()
    assert first.name == second.name
    client.wait(first)
    assert client.optimise_map(fleet.name).name != first.name


def test_a_map_without_submaps_is_not_optimised(client, town):
    done = client.wait(client.optimise_map(town))
    assert done.result == {"outcome": "the map holds no submaps"}
    assert client.map_versions(town) == []
