"""Bounds on what is taken in, at the bound and one above, on both transports (row R06, promise P10)."""

from __future__ import annotations

import contextlib
import queue
import socket
import time
from urllib.parse import urlsplit

import grpc
import httpx
import pytest
from google.rpc import error_details_pb2, status_pb2

from revisit import ApiError, Client, Cloud
from revisit.formats import QUANTISED, encode_quantised
from revisit.sdk.retry import RetryPolicy
from revisit.service.capacity import backlog
from revisit.service.capacity.limits import CALL_POINTS, CapacityLimits
from revisit.v1 import cloud_pb2, geometry_pb2, ingest_pb2, ingest_pb2_grpc
from tests.support.live_service import connected, live_service
from tests.support.patience import PATIENCE_S, eventually
from tests.support.service_world import cloud_points, pose

POINTS = 300
ONCE = RetryPolicy(attempts=1)
STREAMS = 3
CLOUD = encode_quantised(cloud_points(1, POINTS))


@pytest.fixture(scope="module")
def service():
    with live_service(max_queued_jobs=5) as running:
        running.working.clear()
        yield running


@pytest.fixture
def limits(service, monkeypatch):
    """Bounds for one test; buckets start full."""
    in_flight, jobs = service.world.context.in_flight, service.world.context.backlog

    def of(**bounds):
        monkeypatch.setattr(in_flight, "limits", CapacityLimits(**bounds))
        in_flight._rates._buckets.clear()
        monkeypatch.setattr(jobs, "_waiting", {})
        monkeypatch.setattr(jobs, "_recounted_s", {})

    of()
    yield of
    service.world.work_off()


@pytest.fixture(params=["rest", "grpc"])
def client(request, service):
    with connected(service, request.param) as made:
        yield made


@pytest.fixture
def session(client, request, limits):
    return client.create_session(client.create_map(f"m{abs(hash(request.node.name))}"), "monday")


def post(client, session, number):
    return client.post_submap(session, f"s{number}", cloud_points(number, POINTS), pose(), 1)


def test_points_beyond_a_quota_are_refused_with_the_time_to_come_back(client, session, limits, service, monkeypatch):
    monkeypatch.setattr(service.world.context.in_flight._rates, "_now_s", lambda: 1000.0)
    # A quota of two clouds; the third is the one that goes into debt, for the balance is then exactly zero.
    limits(tenant_points_per_s=2.0 * (POINTS + CALL_POINTS) / 10.0, burst_s=10.0)
    for number in range(3):
        post(client, session, number)
    before = service.stored()
    with pytest.raises(ApiError) as refused:
        post(client, session, 3)
    assert (refused.value.reason, refused.value.code, refused.value.retryable) == ("RATE", "RESOURCE_EXHAUSTED", True)
    # One cloud is owed and 260 points come a second: about 5 s, rounded up over REST.
    assert 4.0 <= refused.value.retry_after_s <= 6.0
    assert service.stored() == before


def test_a_full_queue_refuses_one_more_job_on_either_transport(client, session, service, limits, monkeypatch):
    monkeypatch.setattr(backlog, "BACKLOG_RECOUNT_S", 3600.0)
    queued = service.world.context.transactions.read(lambda uow: uow.jobs.count("default", state="QUEUED")).result()
    for number in range(5 - queued):
        post(client, session, number)
    with pytest.raises(ApiError) as refused:
        post(client, session, 9)
    assert (refused.value.reason, refused.value.code) == ("WORKERS_BUSY", "UNAVAILABLE")
    assert refused.value.retryable and refused.value.retry_after_s >= 1.0
    with pytest.raises(ApiError, match="WORKERS_BUSY"):
        # Nothing is decoded to find that out: what is no cloud is not called one.
        client.post_submap(session, "no-cloud", Cloud(b"no cloud", QUANTISED), pose(), 1)
    service.world.work_off()
    with pytest.raises(ApiError, match="WORKERS_BUSY"):
        post(client, session, 9)
    monkeypatch.setattr(backlog, "BACKLOG_RECOUNT_S", 0.0)
    post(client, session, 9)


def test_a_stream_goes_on_where_the_queue_is_full(service, limits):
    with Client.grpc(service.grpc, retry=ONCE) as client:
        session = client.create_session(client.create_map("streaming"), "s")
        service.world.context.backlog._waiting["default"] = 5
        with client.stream(session) as stream:
            stream.send(cloud_points(1, POINTS), pose(), 1)
        assert stream.committed_seq == 1


def test_a_refused_body_is_not_even_read(service, limits):
    with httpx.Client(base_url=service.http, trust_env=False) as http:
        http.post("/v1/maps", json={"map_id": "unread"})
        http.post("/v1/maps/unread/sessions", json={"session_id": "s"})
        limits(points_per_s=1.0)
        service.world.context.in_flight.charge_call("default", 10_000)
        path = "/v1/maps/unread/sessions/s/submaps?submap_id=a&stamp_ns=1&T_odom_submap=0,0,0,0,0,0,1"
        head = (
            f"POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: {QUANTISED}\r\nContent-Length: 1000000\r\n\r\n"
        )
        where = urlsplit(service.http)
        with socket.create_connection((where.hostname, where.port), timeout=PATIENCE_S) as connection:
            # The body is promised and never sent: whoever wanted to read it would wait until its time is up.
            connection.sendall(head.encode())
            answer = connection.recv(65_536).decode()
    status, _, rest = answer.partition("\r\n")
    assert status.split()[1] == "429"
    assert "retry-after:" in rest.lower()


class Held:
    """A stream that is held open."""

    def __init__(self, stub, session):
        self._requests = queue.SimpleQueue()
        self._requests.put(ingest_pb2.StreamScansRequest(open=ingest_pb2.Open(session=session)))
        self.call = stub.StreamScans(iter(self._requests.get, None), timeout=PATIENCE_S)

    def opened(self):
        return next(self.call).opened

    def send(self, seq):
        where = geometry_pb2.Transform(
            translation=geometry_pb2.Vector3(x=float(seq)), rotation=geometry_pb2.Quaternion(w=1.0)
        )
        encoded = cloud_pb2.EncodedCloud(content_type=QUANTISED, data=CLOUD)
        scan = ingest_pb2.Scan(seq=seq, stamp_ns=seq, t_odom_sensor=where, cloud=cloud_pb2.Cloud(encoded=encoded))
        self._requests.put(ingest_pb2.StreamScansRequest(scan=scan))

    def close(self):
        self._requests.put(None)
        self.call.cancel()


@pytest.fixture
def streams(service, limits):
    """Opens streams into sessions of their own; closes all at the end."""
    with contextlib.ExitStack() as held, Client.grpc(service.grpc, retry=ONCE) as client:
        channel = held.enter_context(grpc.insecure_channel(service.grpc))
        stub = ingest_pb2_grpc.IngestServiceStub(channel)
        town = client.create_map(f"streams-{time.monotonic_ns()}")

        def into(number):
            session = client.create_session(town, f"s{number}")
            stream = Held(stub, session.name)
            held.callback(stream.close)
            return stream

        yield into


def test_one_stream_too_many_is_refused_and_a_closed_one_makes_room(streams, service, limits):
    limits(client_streams=STREAMS)
    opened = [streams(number) for number in range(STREAMS)]
    for stream in opened:
        assert stream.opened().credits == 32
    with pytest.raises(grpc.RpcError) as refused:
        streams(STREAMS).opened()
    assert refused.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
    status = status_pb2.Status.FromString(dict(refused.value.trailing_metadata())["grpc-status-details-bin"])
    kinds = {detail.type_url.rpartition(".")[2]: detail for detail in status.details}
    delay = error_details_pb2.RetryInfo()
    assert kinds["RetryInfo"].Unpack(delay) and delay.retry_delay.ToMilliseconds() > 0
    # A robot that comes back before its dead connection was noticed gets the place of that one.
    assert streams(0).opened().credits == 32
    opened[1].close()
    in_flight = service.world.context.in_flight
    eventually(lambda: in_flight.streams == STREAMS - 1, "a closed stream keeps its place")
    assert streams(STREAMS).opened().credits == 32


def test_three_hundred_streams_of_one_client_are_eight(streams, service):
    attempts = [streams(number) for number in range(40)]
    outcomes = []
    for stream in attempts:
        try:
            outcomes.append(stream.opened().credits)
        except grpc.RpcError as error:
            outcomes.append(error.code())
    assert outcomes.count(32) == 8
    assert outcomes.count(grpc.StatusCode.RESOURCE_EXHAUSTED) == 32


def test_a_throttled_stream_waits_and_loses_nothing(service, limits):
    with Client.grpc(service.grpc, retry=RetryPolicy(base_s=0.01)) as client:
        session = client.create_session(client.create_map("throttled"), "s")
        limits(tenant_points_per_s=20.0 * (POINTS + CALL_POINTS), burst_s=0.1)
        with client.stream(session) as stream:
            for number in range(1, 9):
                stream.send(cloud_points(number, POINTS), pose(0.1 * number), number)
        assert (stream.committed_seq, stream.rejected) == (8, [])
