"""A key that begins too many calls waits for its turn, refused or not, and no other key does (P11)."""

from __future__ import annotations

import grpc
import httpx
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from revisit import ApiError, Client
from revisit.sdk.retry import RetryPolicy
from tests.support.credentials import a_key
from tests.support.paced import BURST


def client_of(paced, transport, key):
    once = RetryPolicy(attempts=1)
    if transport == "rest":
        return Client(paced.http, api_key=key, retry=once)
    return Client.grpc(paced.grpc, api_key=key, retry=once)


@pytest.mark.parametrize("transport", ["rest", "grpc"])
def test_a_key_that_begins_too_many_calls_waits_and_another_does_not(paced, line, transport):
    """Reading one resource costs as much as being refused: the map is not there."""
    greedy, modest = (a_key(paced.world, f"{who}-{transport}").text for who in ("greedy", "modest"))
    line.start_anew()
    told = []
    with client_of(paced, transport, greedy) as client:
        for _ in range(2 * BURST + 1):
            with pytest.raises(ApiError) as refused:
                client.get_map("maps/nowhere")
            told.append(refused.value.reason)
    assert told == ["NOT_FOUND"] * 2 * BURST + ["RATE"]
    assert line.waited == BURST
    with client_of(paced, transport, modest) as client:
        client.create_map("town")
    assert line.waited == BURST


@pytest.mark.parametrize("transport", ["rest", "grpc"])
def test_a_stranger_that_is_refused_too_often_waits(paced, line, transport):
    a_key(paced.world)
    line.start_anew()
    with client_of(paced, transport, "rv_none") as client:
        for _ in range(BURST + 2):
            with pytest.raises(ApiError) as refused:
                client.get_map("maps/nowhere")
            assert refused.value.reason == "UNAUTHENTICATED"
    assert line.waited == 2


def test_whoever_asks_for_what_there_is_none_of_too_often_waits(paced, line):
    line.start_anew()
    with httpx.Client(base_url=paced.http, trust_env=False) as http:
        assert {http.get("/nowhere").status_code for _ in range(BURST + 2)} == {404}
    assert line.waited == 2


def test_a_body_that_is_refused_unread_makes_further_calls_wait(paced, line):
    headers = {"authorization": f"Bearer {a_key(paced.world, 'wasteful').text}", "content-type": "application/json"}
    line.start_anew()
    with httpx.Client(base_url=paced.http, trust_env=False, headers=headers) as http:
        assert http.post("/v1/maps", content=b"[" + b" " * 2**17 + b"]").status_code == 413
        assert http.get("/v1/maps/nowhere").status_code == 404
    assert line.waited == 1


def test_long_json_makes_further_calls_wait_whether_it_is_good_or_not(paced, line):
    headers = {"authorization": f"Bearer {a_key(paced.world, 'talkative').text}", "content-type": "application/json"}
    line.start_anew()
    with httpx.Client(base_url=paced.http, trust_env=False, headers=headers) as http:
        long = b'{"descriptor": [' + b"0.0, " * 10_000 + b'0.0], "wrong": 1}'
        assert http.post("/v1/maps/town/submaps:search", content=long).status_code == 422
        assert http.get("/v1/maps/nowhere").status_code == 404
    assert line.waited == 1


def test_pages_without_a_key_come_at_a_pace_and_health_is_told_beyond_it(paced, line):
    line.start_anew()
    with httpx.Client(base_url=paced.http, trust_env=False) as http:
        told = [http.get("/page.js").status_code for _ in range(2 * BURST + 1)]
        assert (told, line.waited) == ([200] * 2 * BURST + [429], BURST)
        assert {http.get(path).status_code for path in ("/livez", "/readyz") for _ in range(BURST)} == {200}


def test_watches_of_health_come_at_a_pace_and_health_is_told_beyond_it(paced, line):
    line.start_anew()
    with grpc.insecure_channel(paced.grpc) as channel:
        stub, asked = health_pb2_grpc.HealthStub(channel), health_pb2.HealthCheckRequest()
        watches = [stub.Watch(asked) for _ in range(2 * BURST + 1)]
        refused = [watch for watch in watches if _is_refused(watch)]
        assert (len(refused), line.waited) == (1, BURST)
        assert {stub.Check(asked).status for _ in range(2 * BURST + 1)} == {1}
        for watch in watches:
            watch.cancel()


def _is_refused(watch):
    """Whether a watch is told to come later, and not the state of the service."""
    try:
        return next(watch).status != 1
    except grpc.RpcError as error:
        return error.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
