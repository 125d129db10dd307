"""Merging maps, the same over REST and gRPC: dry runs, merges, what they tell, taking them back. Simulated."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.sdk.errors import InvalidArgument, NotFound
from tests.support.fake_merger import CAR
from tests.support.fleet_in_service import fleet_in_two
from tests.support.service_world import cloud_points, pose

_numbers = itertools.count(1)


@pytest.fixture
def two(service):
    """A fleet of two robots, each in a map of its own."""
    number = next(_numbers)
    return fleet_in_two(service.world, (f"one-{number}", f"two-{number}"), sessions=2, submaps=30, per_pair=0)


def other(fleet):
    """The name of the second map."""
    return fleet.name.replace("one", "two")


def merged(client, fleet, **asked):
    return client.wait(client.merge_map(fleet.name, other(fleet), **asked)).result


def everything(client, map_name):
    """What a client can read of a map."""
    sessions = client.list_sessions(map_name)
    return (
        [(one.name, one.state) for one in sessions],
        [client.list_submaps(session) for session in sessions],
        client.loop_closures(map_name, state="ALL"),
    )


def test_a_dry_run_tells_alignment_evidence_and_what_would_change_and_changes_nothing(client, two):
    before = everything(client, two.name)
    proposed = merged(client, two, validate_only=True)
    assert (proposed["verdict"], proposed["refusal"], proposed["source"]) == ("MERGEABLE", None, other(two))
    assert proposed["evidence"]["loops"] >= proposed["limits"]["loops"]
    assert proposed["evidence"]["common_track_m"] > 50.0 and proposed["evidence"]["rival_loops"] == 0
    assert (proposed["would_change"]["sessions_joined"], proposed["would_change"]["submaps"]) == (1, 30)
    truth, odometry = two.fleet.truth, {one.session: one.T_odom_submap for one in two.fleet.graph.trajectories}
    T_world_map, T_world_other = (truth[name][0] @ se3.inverse(odometry[name][0]) for name in ("s0", "s1"))
    apart = se3.inverse(T_world_map @ np.reshape(proposed["T_map_source"], (4, 4))) @ T_world_other
    # Of the drift of both drives a part stays.
    assert np.linalg.norm((apart @ odometry["s1"][0])[:3, 3] - odometry["s1"][0][:3, 3]) < 5.0
    assert np.linalg.eigvalsh(np.reshape(proposed["covariance"], (6, 6))).min() > 0.0
    assert everything(client, two.name) == before and client.map_merges(two.name) == []


def test_a_merge_puts_both_robots_into_one_frame_and_leaves_the_source_as_it_was(client, two):
    source = everything(client, other(two))
    result = merged(client, two)
    assert result["verdict"] == "MERGED"
    version = client.get_map_version(result["version"])
    assert (version.summary.sessions, version.summary.frames, version.summary.submaps) == (2, 1, 60)
    assert two.fleet.error_m(two.poses(client.submap_poses(version))) < 1.0
    assert client.correction(f"{two.name}/sessions/s1").frame == client.correction(f"{two.name}/sessions/s0").frame
    assert client.get_session(f"{two.name}/sessions/s1").state == "FINISHED"
    assert everything(client, other(two)) == source
    hits = client.search(two.name, submap=f"{two.name}/sessions/s0/submaps/003", k=60)
    assert any("/sessions/s1/" in hit.submap for hit in hits)


def test_a_merge_is_listed_with_its_evidence_and_the_changes_between_the_days(client, two):
    result = merged(client, two)
    (merge,) = client.map_merges(two.name)
    assert client.get_map_merge(result["merge"]) == merge
    assert (merge.source, merge.version_before, merge.version) == (other(two), 0, 1)
    assert merge.sessions == (f"{two.name}/sessions/s1",)
    assert merge.report["evidence"] == result["evidence"] and "changes" not in merge.report
    (car,) = merge.changes
    assert (car.kind, car.centre_m, car.extent_m, car.points) == ("VANISHED", CAR.centre_m, CAR.extent_m, CAR.points)


def test_a_merge_that_is_taken_back_leaves_the_map_as_it_was_to_a_bit(client, two):
    client.wait(client.optimise_map(two.name))
    first, before = client.get_map_version(f"{two.name}/versions/1"), everything(client, two.name)
    result = merged(client, two)
    reverted = client.revert_merge(result["merge"])
    assert reverted.reverted_at_ns is not None
    restored = client.get_map_version(f"{two.name}/versions/3")
    assert (restored.content_hash, restored.restored_from, restored.in_force) == (first.content_hash, 1, True)
    after = everything(client, two.name)
    for index in (0, 2):
        assert after[index] == before[index]
    for old, new in zip(before[1][0], after[1][0], strict=True):
        np.testing.assert_array_equal(new.in_map.T_map, old.in_map.T_map)
    assert client.revert_merge(result["merge"]) == reverted
    assert merged(client, two)["verdict"] == "MERGED"


def test_a_merge_of_a_map_without_poses_is_taken_back_to_that(client, two):
    reverted = client.revert_merge(merged(client, two)["merge"])
    assert reverted.version_before == 0
    assert client.list_submaps(f"{two.name}/sessions/s0")[0].in_map is None


def test_an_optimisation_after_a_merge_moves_nothing(client, two):
    merged(client, two)
    again = client.get_map_version(client.wait(client.optimise_map(two.name)).result["version"])
    assert again.summary.max_change_m < 1e-9 and again.summary.frames == 1


def test_any_base_gives_the_same_poses(client, two):
    names = (two.name, other(two))
    poses = []
    for into, source in (names, names[::-1]):
        result = client.wait(client.merge_map(into, source)).result
        poses.append({one.submap.split("/", 2)[2]: one.T_map_submap for one in client.submap_poses(result["version"])})
        client.revert_merge(result["merge"])
    origin = next(iter(poses[0]))
    for name, T_map_submap in poses[0].items():
        here, there = (se3.inverse(one[origin]) @ one[name] for one in poses)
        np.testing.assert_allclose(here, there, rtol=0, atol=1e-6, err_msg=f"{name} {T_map_submap[:3, 3]}")


def test_one_session_of_a_map_is_merged_and_renamed_where_its_name_is_taken(client, two):
    client.create_session(two.name, "s1")
    result = client.wait(client.merge_map(two.name, f"{other(two)}/sessions/s1")).result
    assert result["sessions"] == [f"{two.name}/sessions/{other(two).partition('/')[2]}.s1"]


def test_an_initial_pose_narrows_the_search_and_one_that_is_wrong_leads_to_a_refusal(client, two):
    found = merged(client, two, validate_only=True)
    near = np.reshape(found["T_map_source"], (4, 4))
    narrowed = merged(client, two, validate_only=True, T_map_source=near, radius_m=5.0)
    assert narrowed["verdict"] == "MERGEABLE"
    assert narrowed["evidence"]["candidates"] < found["evidence"]["candidates"]
    far = near.copy()
    far[:2, 3] += 300.0
    refused = merged(client, two, T_map_source=far, radius_m=15.0)
    assert (refused["verdict"], refused["refusal"]) == ("REFUSED", "TOO_FEW_LOOPS")
    assert client.map_merges(two.name) == []


def test_maps_without_a_common_place_are_refused_with_a_reason(client, service, two):
    number = next(_numbers)
    far = fleet_in_two(service.world, (f"far-{number}", f"farther-{number}"), seed=9, sessions=2, submaps=5, per_pair=0)
    refused = client.wait(client.merge_map(two.name, far.name)).result
    assert refused["verdict"] == "REFUSED"
    assert refused["refusal"] in ("TOO_FEW_LOOPS", "COMMON_TRACK_TOO_SHORT")
    assert "version" not in refused


def test_what_cannot_be_merged_is_told_at_once(client, session, two):
    town = session.name.partition("/sessions/")[0]
    with pytest.raises(InvalidArgument) as refused:
        client.merge_map(town, f"{town}/sessions/monday")
    assert refused.value.reason == "BAD_FIELD"
    with pytest.raises(InvalidArgument):
        client.merge_map(town, two.name, radius_m=5.0)
    for into, source in ((town, "maps/nothing"), ("maps/nothing", town), (town, f"{two.name}/sessions/nobody")):
        with pytest.raises(NotFound):
            client.merge_map(into, source)
    empty = client.wait(client.merge_map(two.name, town))
    assert "holds no described submap" in empty.result["outcome"]


def test_operations_that_wait_are_cancelled_at_once_and_only_some_kinds_can_be(client, service, session, two):
    service.working.clear()
    try:
        posted = client.post_submap(session, "a", cloud_points(1), pose(1.0), 1)
        waiting = client.merge_map(two.name, other(two))
        assert client.merge_map(two.name, other(two)).name == waiting.name
        optimising = client.optimise_map(two.name)
        for operation in (waiting, optimising):
            ended = client.cancel_operation(operation)
            assert (ended.state, ended.cancel_requested) == ("DONE", True)
            assert ended.result == {"outcome": "the operation was cancelled"}
        with pytest.raises(InvalidArgument):
            client.cancel_operation(posted)
    finally:
        service.working.set()
    client.wait(posted)
    assert client.map_merges(two.name) == []
    done = client.get_operation(waiting.name)
    assert client.cancel_operation(waiting) == done
