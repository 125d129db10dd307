"""SIGTERM with clients that hang on either transport: new work is refused, the end comes all the same (P13)."""

from __future__ import annotations

import queue
import signal
import socket
import time

import grpc
import httpx
import pytest

from revisit.v1 import ingest_pb2, ingest_pb2_grpc
from tests.support.processes import ServiceProcess

DRAIN_S = 2.0


@pytest.fixture
def service(tmp_path):
    running = ServiceProcess(tmp_path / "home", drain_s=DRAIN_S)
    with httpx.Client(base_url=running.url, trust_env=False) as client:
        client.post("/v1/maps", json={"map_id": "town"})
        client.post("/v1/maps/town/sessions", json={"session_id": "monday"})
    yield running
    running.close()


def half_a_post(service) -> socket.socket:
    """A connection that has sent the head of a post and never sends the rest."""
    host, port = service.url.removeprefix("http://").split(":")
    connection = socket.create_connection((host, int(port)))
    connection.sendall(
        b"POST /v1/maps HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 999\r\n\r\n{"
    )
    return connection


def test_clients_that_hang_on_either_transport_do_not_delay_the_end(service):
    hung = [half_a_post(service) for _ in range(5)]
    requests = queue.SimpleQueue()
    requests.put(ingest_pb2.StreamScansRequest(open=ingest_pb2.Open(session="maps/town/sessions/monday")))
    with grpc.insecure_channel(service.grpc_target) as channel:
        call = ingest_pb2_grpc.IngestServiceStub(channel).StreamScans(iter(requests.get, None), timeout=60)
        assert next(call).opened.committed_seq == 0
        began_s = time.monotonic()
        service._process.send_signal(signal.SIGTERM)
        # The stream is told to leave; the client takes no notice and keeps its side open.
        assert next(call).HasField("drain")
        told_s = time.monotonic() - began_s
        assert service._process.wait(15) == 0
        ended_s = time.monotonic() - began_s
        requests.put(None)
    for connection in hung:
        connection.close()
    assert told_s < 2.0
    assert ended_s < DRAIN_S + 10.0


def test_new_work_is_refused_while_old_work_ends(service):
    with httpx.Client(base_url=service.url, trust_env=False, timeout=10) as client:
        assert client.get("/livez").status_code == 200  # a connection that is kept
        hung = half_a_post(service)  # what the drain waits for
        service._process.send_signal(signal.SIGTERM)
        service.wait_for("draining")
        try:
            answer = client.post("/v1/maps", json={"map_id": "late"})
            assert (answer.status_code, answer.json()["reason"]) == (503, "DRAINING")
            assert answer.headers["retry-after"]
        except httpx.TransportError:
            pass  # refused before HTTP: as good
        hung.close()
    assert service._process.wait(15) == 0
