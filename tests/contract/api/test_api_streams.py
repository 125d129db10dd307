"""Streams of scans: acknowledged after the commit, replayed without effect, refused one by one, resumed."""

from __future__ import annotations

import queue
import threading

import grpc
import numpy as np
import pytest

from revisit import ApiError, Client, Cloud
from revisit.formats import NPY, QUANTISED, encode_npy, encode_quantised
from revisit.sdk.errors import AlreadyExists
from revisit.sdk.retry import RetryPolicy
from revisit.v1 import cloud_pb2, geometry_pb2, ingest_pb2, ingest_pb2_grpc
from tests.support.live_service import live_service
from tests.support.patience import PATIENCE_S
from tests.support.service_world import cloud_points, pose

BAD_CLOUD = Cloud(encode_npy(np.full((300, 3), np.nan, np.float32)), NPY)


def drive(stream, scans, start=1):
    for number in range(start, start + scans):
        stream.send(cloud_points(number), pose(float(number)), number)


def test_streamed_scans_are_committed_and_become_submaps(client, session):
    with client.stream(session) as stream:
        assert stream.committed_seq == 0
        drive(stream, 13)
    assert stream.committed_seq == 13
    # 12 m of travel: one window of 10 m is complete (scans at 1 m to 11 m).
    assert len(stream.submaps) == 1
    submap = client.get_submap(stream.submaps[0])
    assert (submap.first_seq, submap.last_seq, submap.scan_count) == (1, 11, 11)
    assert client.get_session(session.name).committed_seq == 13


def test_a_stream_goes_on_where_the_last_one_ended(client, session):
    with client.stream(session) as stream:
        drive(stream, 3)
    with client.stream(session) as stream:
        assert stream.committed_seq == 3
        drive(stream, 2, start=4)
    assert client.get_session(session.name).committed_seq == 5


def test_finishing_makes_a_submap_of_the_last_shorter_window(client, session):
    with client.stream(session) as stream:
        drive(stream, 4)
    assert client.finish_session(session).state == "FINISHED"
    (submap,) = client.list_submaps(session)
    assert (submap.first_seq, submap.last_seq) == (1, 4)


def test_a_stream_into_nowhere_and_into_a_finished_session_is_refused(client, session):
    with pytest.raises(ApiError, match="NOT_FOUND"), client.stream("maps/nowhere/sessions/s"):
        pass
    client.finish_session(session)
    with pytest.raises(ApiError, match="SESSION_FINISHED"), client.stream(session) as stream:
        drive(stream, 1)


def test_rest_refuses_a_gap_and_names_the_expected_scan(service, session):
    with Client(service.http) as client:
        cloud = Cloud(encode_quantised(cloud_points(1)), QUANTISED)
        unrotated = {"translation": dict.fromkeys("xyz", 0.0), "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
        before = service.stored()
        with pytest.raises(ApiError) as refused:
            client._transport.append_scan(session.name, 5, unrotated, 1, cloud)
        assert (refused.value.reason, refused.value.expected_seq) == ("SEQ_GAP", 1)
        for seq in (0, -1, 2**64 - 1):
            with pytest.raises(ApiError, match="BAD_FIELD"):
                client._transport.append_scan(session.name, seq, unrotated, 1, cloud)
        assert service.stored() == before


@pytest.fixture
def raw(service):
    """A bare stub: what a client of another language would see."""
    with grpc.insecure_channel(service.grpc) as channel:
        yield ingest_pb2_grpc.IngestServiceStub(channel)


class Conversation:
    """A stream driven message by message."""

    def __init__(self, stub):
        self._requests = queue.SimpleQueue()
        self._answers = stub.StreamScans(iter(self._requests.get, None), timeout=PATIENCE_S)

    def say(self, **request):
        self._requests.put(ingest_pb2.StreamScansRequest(**request))
        return self

    def hear(self):
        return next(self._answers)

    def end(self):
        self._requests.put(None)
        return list(self._answers)


def scan_message(seq, x_m=None, data=None, content_type=QUANTISED, stamp_ns=1):
    rotation = geometry_pb2.Quaternion(w=1.0)
    where = geometry_pb2.Transform(
        translation=geometry_pb2.Vector3(x=float(seq if x_m is None else x_m)), rotation=rotation
    )
    encoded = cloud_pb2.EncodedCloud(content_type=content_type, data=data or encode_quantised(cloud_points(1)))
    return ingest_pb2.Scan(seq=seq, stamp_ns=stamp_ns, t_odom_sensor=where, cloud=cloud_pb2.Cloud(encoded=encoded))


def code_of(call):
    with pytest.raises(grpc.RpcError) as ended:
        call()
    return ended.value.code()


def opened(raw, session):
    talk = Conversation(raw).say(open=ingest_pb2.Open(session=session.name))
    assert talk.hear().opened.credits == 32
    return talk


def test_a_replayed_scan_is_acknowledged_and_ignored(raw, session, service):
    talk = opened(raw, session)
    assert talk.say(scan=scan_message(1)).hear().ack.committed_seq == 1
    before = service.stored()
    assert talk.say(scan=scan_message(1)).hear().ack.committed_seq == 1
    assert talk.end() == []
    assert service.stored() == before


def test_another_scan_under_a_used_number_is_refused_with_what_to_do(raw, session, service):
    talk = opened(raw, session)
    assert talk.say(scan=scan_message(1)).hear().ack.committed_seq == 1
    before = service.stored()
    for other in (
        scan_message(1, x_m=99.0),
        scan_message(1, stamp_ns=2),
        scan_message(1, data=encode_quantised(cloud_points(2))),
    ):
        nack = talk.say(scan=other).hear().nack
        assert (nack.seq, nack.reason, nack.retryable, nack.expected_seq) == (1, "ALREADY_EXISTS", False, 2)
        assert "create a new session" in nack.message
    assert talk.end() == []
    assert service.stored() == before
    with Client(service.http) as client:
        unrotated = {"translation": dict.fromkeys("xyz", 0.0), "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
        cloud = Cloud(encode_quantised(cloud_points(1)), QUANTISED)
        with pytest.raises(AlreadyExists, match="create a new session"):
            client._transport.append_scan(session.name, 1, unrotated, 1, cloud)


def test_a_gap_is_refused_with_the_expected_number_and_the_stream_lives(raw, session):
    talk = opened(raw, session)
    nack = talk.say(scan=scan_message(5)).hear().nack
    assert (nack.seq, nack.reason, nack.expected_seq, nack.retryable) == (5, "SEQ_GAP", 1, False)
    assert talk.say(scan=scan_message(1)).hear().ack.committed_seq == 1
    assert talk.end() == []


def test_time_that_goes_backwards_gets_a_nack_and_the_stream_lives(raw, session):
    talk = opened(raw, session)
    assert talk.say(scan=scan_message(1, stamp_ns=500)).hear().ack.committed_seq == 1
    nack = talk.say(scan=scan_message(2, stamp_ns=499)).hear().nack
    assert (nack.seq, nack.reason, nack.expected_seq, nack.retryable) == (2, "BAD_FIELD", 2, False)
    assert "500" in nack.message
    assert talk.say(scan=scan_message(2, stamp_ns=500)).hear().ack.committed_seq == 2
    assert talk.end() == []


def test_a_bad_scan_gets_a_nack_and_the_stream_lives(raw, session, service):
    talk = opened(raw, session)
    before = service.stored()
    bad = [
        ("MALFORMED_BODY", "", scan_message(1, data=b"not a cloud")),
        ("UNUSABLE_CLOUD", "NaN or infinite", scan_message(1, data=BAD_CLOUD.data, content_type=NPY)),
        ("UNSUPPORTED_ENCODING", "", scan_message(1, content_type="text/plain")),
        ("UNUSABLE_CLOUD", "is missing", ingest_pb2.Scan(seq=1, t_odom_sensor=scan_message(1).t_odom_sensor)),
        ("BAD_FIELD", "T_odom_sensor", ingest_pb2.Scan(seq=1, cloud=scan_message(1).cloud)),
        ("BAD_FIELD", "seq", scan_message(0)),
    ]
    for reason, words, message in bad:
        nack = talk.say(scan=message).hear().nack
        assert (nack.reason, nack.expected_seq) == (reason, 1)
        assert words in nack.message
    assert service.stored() == before
    assert talk.say(scan=scan_message(1)).hear().ack.committed_seq == 1


def test_a_packed_cloud_is_taken_as_it_is(raw, session):
    points = cloud_points(1)
    fields = [cloud_pb2.PackedField(name=n, offset=4 * i, datatype=7, count=1) for i, n in enumerate("xyz")]
    packed = cloud_pb2.PackedCloud(
        fields=fields, point_stride=12, width=len(points), height=1, data=points.astype("<f4").tobytes()
    )
    scan = ingest_pb2.Scan(seq=1, t_odom_sensor=scan_message(1).t_odom_sensor, cloud=cloud_pb2.Cloud(packed=packed))
    talk = opened(raw, session)
    assert talk.say(scan=scan).hear().ack.committed_seq == 1
    packed.width = 2**31
    refused = ingest_pb2.Scan(seq=2, t_odom_sensor=scan.t_odom_sensor, cloud=cloud_pb2.Cloud(packed=packed))
    assert talk.say(scan=refused).hear().nack.reason in ("MALFORMED_BODY", "TOO_LARGE")


def test_data_before_open_and_a_second_open_end_the_stream(raw, session):
    early = Conversation(raw).say(scan=scan_message(1))
    assert code_of(early.hear) is grpc.StatusCode.INVALID_ARGUMENT
    twice = opened(raw, session).say(open=ingest_pb2.Open(session=session.name))
    assert code_of(twice.hear) is grpc.StatusCode.INVALID_ARGUMENT
    assert code_of(Conversation(raw).say(open=ingest_pb2.Open(session="nonsense")).hear) is (
        grpc.StatusCode.INVALID_ARGUMENT
    )


def test_a_newer_stream_of_the_session_fences_the_older(raw, session):
    older = opened(raw, session)
    newer = opened(raw, session)
    assert code_of(older.hear) is grpc.StatusCode.FAILED_PRECONDITION
    assert newer.say(scan=scan_message(1)).hear().ack.committed_seq == 1


def test_a_stream_names_its_session_and_refuses_to_resume_in_another(raw, client, session, town):
    first = Conversation(raw).say(open=ingest_pb2.Open(session=session.name)).hear().opened
    assert (first.committed_seq, first.credits, first.window_bytes) == (0, 32, 8 * 2**20)
    again = ingest_pb2.Open(session=session.name, resume_token=first.resume_token)
    assert Conversation(raw).say(open=again).hear().opened.resume_token == first.resume_token
    other = client.create_session(town, "tuesday")
    for name, token in ((other.name, first.resume_token), (session.name, "forged")):
        talk = Conversation(raw).say(open=ingest_pb2.Open(session=name, resume_token=token))
        assert code_of(talk.hear) is grpc.StatusCode.NOT_FOUND


def test_a_client_that_knows_of_more_scans_than_are_stored_is_told_so(raw, session):
    assert opened(raw, session).say(scan=scan_message(1)).hear().ack.committed_seq == 1
    for acknowledged_seq, code in ((1, None), (2, grpc.StatusCode.FAILED_PRECONDITION)):
        talk = Conversation(raw).say(open=ingest_pb2.Open(session=session.name, acknowledged_seq=acknowledged_seq))
        if code is None:
            assert talk.hear().opened.committed_seq == 1
        else:
            assert code_of(talk.hear) is code


def test_every_scan_is_answered_after_the_client_closes_its_side(raw, session):
    talk = opened(raw, session)
    for seq in range(1, 21):
        talk.say(scan=scan_message(seq))
    answers = [answer.ack.committed_seq for answer in talk.end() if answer.HasField("ack")]
    assert answers == list(range(1, 21))


def test_a_watching_stream_is_told_of_loops(client, service, session, town, raw):
    first = client.create_session(town, "before")
    client.wait(client.post_submap(first, "a", cloud_points(1), pose(), 1))
    talk = Conversation(raw).say(open=ingest_pb2.Open(session=session.name, watch_loop_closures=True))
    assert talk.hear().HasField("opened")
    again = client.wait(client.post_submap(session, "again", cloud_points(1), pose(), 1))
    loop = talk.hear().loop_closed.loop_closure
    assert (loop.query, loop.match) == (again.subject, f"{first.name}/submaps/a")


def test_the_sdk_leaves_out_a_bad_scan_and_goes_on(service, session):
    with Client.grpc(service.grpc) as client, client.stream(session) as stream:
        drive(stream, 3)
        stream.send(BAD_CLOUD, pose(4.0), 4)
        drive(stream, 4, start=5)
        stream.flush()
        assert stream.rejected == [(4, "UNUSABLE_CLOUD")]
        assert "NaN or infinite" in stream.refusals[0].message
        assert stream.committed_seq == 7


def test_a_stored_scan_is_known_again_by_its_number_cloud_pose_and_time(client, session):
    with client.stream(session) as stream:
        drive(stream, 3)
    at = cloud_points(2), pose(2.0), 2
    assert client.holds_scan(session, 2, *at)
    other = (cloud_points(9), *at[1:]), (at[0], pose(2.5), 2), (*at[:2], 3), (np.zeros((300, 3)), *at[1:])
    assert [client.holds_scan(session, 2, *scan) for scan in other] == [False] * 4
    assert not client.holds_scan(session, 1, *at)
    assert not client.holds_scan(session, 4, cloud_points(4), pose(4.0), 4)
    assert client.get_session(session.name).committed_seq == 3


class CuttingProxy:
    """A gRPC stream whose connection is lost after every few answers."""

    def __init__(self, call, answers_per_connection):
        self._call, self._limit, self.connections = call, answers_per_connection, 0

    def __call__(self, requests):
        self.connections += 1
        call = self._call(requests)

        def answers():
            for number, answer in enumerate(call):
                if number == self._limit:
                    call.cancel()
                    raise ConnectionLost
                yield answer

        return _Cut(answers(), call)


class _Cut:
    def __init__(self, answers, call):
        self._answers, self.cancel = answers, call.cancel

    def __iter__(self):
        return self._answers


class ConnectionLost(grpc.RpcError):
    def code(self):
        return grpc.StatusCode.UNAVAILABLE

    def details(self):
        return "connection lost"

    def trailing_metadata(self):
        return ()


def test_the_sdk_resumes_after_lost_connections_without_losing_or_repeating_a_scan(service, session):
    from revisit.sdk.grpc_transport import _api_error
    from revisit.sdk.scan_stream import GrpcScanSink

    with grpc.insecure_channel(service.grpc) as channel:
        proxy = CuttingProxy(ingest_pb2_grpc.IngestServiceStub(channel).StreamScans, answers_per_connection=7)
        sink = GrpcScanSink(
            proxy, session.name, RetryPolicy(base_s=0.001, cap_s=0.01), lambda error: _api_error(error, "test")
        )
        unrotated = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
        for number in range(1, 41):
            where = {"translation": {"x": number * 0.1, "y": 0.0, "z": 0.0}, "rotation": unrotated}
            sink.send(Cloud(encode_quantised(cloud_points(number)), QUANTISED), where, number)
        sink.flush()
        sink.close()
    assert proxy.connections >= 3
    with Client(service.http) as client:
        stored = client.get_session(session.name)
    # 40 scans, 0.1 m apart: 3.9 m, had one been stored twice or out of order it would be another distance.
    assert (stored.committed_seq, stored.travelled_m) == (40, pytest.approx(3.9))


def test_a_service_nobody_answers_for_is_reported_as_unreachable():
    with Client.grpc("127.0.0.1:1", retry=RetryPolicy(attempts=2, base_s=0.001)) as client:
        with pytest.raises(ApiError, match="UNREACHABLE"):
            client.list_maps()
        with pytest.raises(ApiError, match="UNREACHABLE"), client.stream("maps/m/sessions/s"):
            pass
    with Client("http://127.0.0.1:1", retry=RetryPolicy(attempts=1)) as client, pytest.raises(ApiError):
        client.list_maps()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("scans maps/m/")]


def test_the_newest_stream_holds_over_two_gateways_of_one_store(service, raw, session):
    with live_service(service.world.another_gateway()) as second, grpc.insecure_channel(second.grpc) as channel:
        older = opened(raw, session)
        assert older.say(scan=scan_message(1)).hear().ack.committed_seq == 1
        newer = opened(ingest_pb2_grpc.IngestServiceStub(channel), session)
        # Both are open: the older one is only told where it stores.
        assert newer.say(scan=scan_message(2)).hear().ack.committed_seq == 2
        assert code_of(older.say(scan=scan_message(3)).hear) is grpc.StatusCode.FAILED_PRECONDITION
        assert newer.say(scan=scan_message(3)).hear().ack.committed_seq == 3


def test_the_service_says_which_scans_it_describes_and_where_the_session_stands(raw, session):
    talk = Conversation(raw).say(open=ingest_pb2.Open(session=session.name))
    first = talk.hear().opened
    assert (first.marks.tau_m, first.marks.least_per_tau, first.marks.enough_returns) == (10.0, 5, 300_000)
    assert not first.HasField("t_odom_sensor")
    scan = scan_message(1)
    scan.travelled_m = 7.25
    assert talk.say(scan=scan).hear().ack.committed_seq == 1
    assert talk.end() == []
    again = Conversation(raw).say(open=ingest_pb2.Open(session=session.name)).hear().opened
    assert again.travelled_m == 7.25 and again.t_odom_sensor.translation.x == 1.0


def test_a_pose_is_a_sign_of_life_that_is_answered_and_not_stored(raw, session, service):
    talk = opened(raw, session)
    assert talk.say(scan=scan_message(1)).hear().ack.committed_seq == 1
    before = service.stored()
    ack = talk.say(pose=ingest_pb2.Pose(stamp_ns=2)).hear().ack
    assert (ack.committed_seq, ack.credits) == (1, 0)
    assert service.stored() == before
    assert talk.end() == []


@pytest.mark.parametrize("travelled_m", [-1.0, 1e10, float("nan"), float("inf")])
def test_an_impossible_way_is_refused_and_the_stream_lives(raw, session, travelled_m):
    talk = opened(raw, session)
    scan = scan_message(1)
    scan.travelled_m = travelled_m
    assert talk.say(scan=scan).hear().nack.reason == "BAD_FIELD"
    assert talk.say(scan=scan_message(1)).hear().ack.committed_seq == 1
    assert talk.end() == []


def test_a_robot_sends_what_is_described_and_its_pose_while_it_stands(service, session, monkeypatch):
    monkeypatch.setattr("revisit.sdk.scan_choice.LIFE_S", 0.0)
    points = np.tile(cloud_points(1, 1000), (70, 1))  # of so many returns that marks are 2 m apart
    with Client.grpc(service.grpc) as client, client.stream(session) as stream:
        for number in range(1, 41):
            stream.send(points, pose(0.25 * min(number, 30)), number)
    assert (stream.committed_seq, stream.skipped) == (5, 35)
    with Client.grpc(service.grpc) as client, client.stream(session, send="all") as stream:
        for number in range(41, 44):
            stream.send(points, pose(7.5), number)
        assert stream.skipped == 0
    with Client(service.http) as client:
        told = client.get_session(session.name)
        assert (told.committed_seq, told.travelled_m) == (8, pytest.approx(7.25))


def test_a_stream_knows_no_third_choice(client, session):
    with pytest.raises(ValueError, match="'described' or 'all'"), client.stream(session, send="some"):
        pass
