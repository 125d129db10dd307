"""Conversations about where a robot is, over gRPC: answered scan by scan, refused one by one, ended, begun anew."""

from __future__ import annotations

import grpc
import numpy as np
import pytest

from revisit import AsyncClient, Client, Cloud
from revisit.formats import NPY, encode_npy
from revisit.sdk import errors
from revisit.sdk.retry import RetryPolicy
from revisit.service.capacity.limits import CapacityLimits
from revisit.v1 import loop_closure_pb2 as pb
from revisit.v1 import loop_closure_pb2_grpc
from tests.support.live_service import live_service
from tests.support.service_world import cloud_points, memory_world, pose

ONCE = RetryPolicy(attempts=1)
BAD_CLOUD = Cloud(encode_npy(np.full((300, 3), np.nan, np.float32)), NPY)


@pytest.fixture
def grpc_client(service):
    with Client.grpc(service.grpc, retry=ONCE) as made:
        yield made


@pytest.fixture
def town(grpc_client):
    """A map with a drive past two places."""
    made = grpc_client.maps.create(f"talk-{np.random.default_rng().integers(2**60)}")
    session = grpc_client.sessions.create(made, "monday")
    for number, seed in enumerate((5, 6)):
        submap = grpc_client.submaps.post(session, str(number), cloud_points(seed), pose(100.0 * number), number)
        grpc_client.operations.wait(submap)
    return made.name


def test_a_robot_is_placed_and_its_pose_moves_with_it(grpc_client, town):
    with grpc_client.relocalise(town) as conversation:
        first = conversation.see(cloud_points(6), pose(7.0))
        second = conversation.see(cloud_points(6), pose(9.0))
    assert (first.state, first.reason, len(first.poses)) == ("PLACED", None, 1)
    (found,) = first.poses
    # No version of the map has the session: the pose is in its odometry.
    assert (found.session, found.in_map) == (f"{town}/sessions/monday", None)
    np.testing.assert_allclose(found.T_session_sensor[:3, 3], [101.0, 0.0, 0.0], atol=1e-9)
    assert found.covariance.shape == (6, 6) and found.accepted == 1
    assert 0.9 < found.probability <= 1.0 - first.none_of_them + 1e-9
    assert second.travelled_m == pytest.approx(2.0)
    assert conversation.begun == 1 and conversation.last is second


def test_a_place_that_the_map_does_not_have_is_unknown_and_why(grpc_client, town):
    with grpc_client.relocalise(town) as conversation:
        answers = [conversation.see(cloud_points(77), pose(5.0 * step)) for step in range(8)]
    assert {one.state for one in answers} == {"UNKNOWN"}
    assert (answers[0].reason, answers[-1].reason) == ("NOT_YET", "NOT_IN_MAP")
    assert all(one.none_of_them == 1.0 and one.poses == () for one in answers)


def test_an_empty_map_and_a_session_that_is_left_out_have_nothing_to_compare(grpc_client, town):
    empty = grpc_client.maps.create(f"{town.removeprefix('maps/')}-empty")
    with grpc_client.relocalise(empty) as conversation:
        assert conversation.see(cloud_points(5), pose()).reason == "MAP_IS_EMPTY"
    with grpc_client.relocalise(town, exclude_session="monday") as conversation:
        assert conversation.see(cloud_points(5), pose()).reason == "MAP_IS_EMPTY"


def test_a_scan_that_cannot_be_used_is_refused_and_the_conversation_goes_on(grpc_client, town):
    with grpc_client.relocalise(town) as conversation:
        with pytest.raises(errors.InvalidArgument):
            conversation.see(BAD_CLOUD, pose())
        with pytest.raises(errors.InvalidArgument, match="last row"):
            conversation.see(cloud_points(5), np.zeros((4, 4)))
        far = cloud_points(5) + np.float32([5_000.0, 0.0, 0.0])
        assert conversation.see(far, pose()).reason == "TOO_FEW_RETURNS"
        assert conversation.see(cloud_points(5), pose()).state == "PLACED"
    assert conversation.begun == 1
    with pytest.raises(errors.FailedPrecondition, match="closed"):
        conversation.see(cloud_points(5), pose())


def test_a_map_that_is_not_there_ends_the_conversation(grpc_client):
    with grpc_client.relocalise("nowhere") as conversation, pytest.raises(errors.NotFound):
        conversation.see(cloud_points(5), pose())


def test_http_has_no_conversations(service, town):
    refused = pytest.raises(errors.FailedPrecondition, match=r"Client\.grpc")
    with Client(service.http) as client, client.relocalise(town) as conversation, refused:
        conversation.see(cloud_points(5), pose())


async def test_a_conversation_on_an_event_loop(service, town):
    async with AsyncClient.grpc(service.grpc, retry=ONCE) as client, client.relocalise(town) as conversation:
        answer = await conversation.see(cloud_points(5), pose())
        assert answer.state == "PLACED" and conversation.begun == 1


def test_after_a_lost_connection_the_conversation_begins_anew(service, town):
    retry = RetryPolicy(attempts=5, base_s=0.01)
    with Client.grpc(service.grpc, retry=retry) as client, client.relocalise(town) as conversation:
        conversation.see(cloud_points(77), pose())
        conversation.see(cloud_points(77), pose(8.0))
        conversation._call._call.cancel()
        answer = conversation.see(cloud_points(6), pose(9.0))
    assert (answer.state, conversation.begun) == ("PLACED", 2)
    # What the first two scans had told is gone.
    assert answer.travelled_m == 0.0


def test_messages_in_the_wrong_order_end_the_stream(service, town):
    opening = pb.RelocaliseRequest(open=pb.RelocaliseOpen(parent=town))
    scan = pb.RelocaliseRequest(scan=pb.RelocaliseScan())
    with grpc.insecure_channel(service.grpc) as channel:
        stub = loop_closure_pb2_grpc.LoopClosureServiceStub(channel)
        for messages in ([], [scan], [opening, opening]):
            with pytest.raises(grpc.RpcError) as refused:
                list(stub.Relocalise(iter(messages)))
            assert refused.value.code() is grpc.StatusCode.INVALID_ARGUMENT
        assert list(stub.Relocalise(iter([opening]))) == []


def test_conversations_are_streams_of_which_a_client_may_have_so_many():
    world = memory_world()
    world.context.in_flight.limits = CapacityLimits(client_streams=1)
    with live_service(world) as service, Client.grpc(service.grpc, retry=ONCE) as client:
        client.maps.create("town")
        with client.relocalise("town") as one, client.relocalise("town") as other:
            one.see(cloud_points(5), pose())
            with pytest.raises(errors.ResourceExhausted):
                other.see(cloud_points(5), pose())


def test_nothing_of_a_conversation_is_stored_but_its_jobs(service, grpc_client, town):
    before = service.stored()
    with grpc_client.relocalise(town) as conversation:
        conversation.see(cloud_points(5), pose())
    after = service.stored()
    assert after[:4] == before[:4]
