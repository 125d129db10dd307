"""SIGTERM with clients that hang on either transport: new work is refused, the end comes all the same (P13)."""

from __future__ import annotations

import queue
import signal
import time

import grpc
import httpx
import pytest

from revisit.v1 import ingest_pb2, ingest_pb2_grpc
from tests.support.patience import PATIENCE_S, in_time
from tests.support.town import SESSION, half_a_post, running_town

DRAIN_S = 2.0


@pytest.fixture
def town(tmp_path):
    with running_town(tmp_path / "home", workers=0, drain_s=DRAIN_S) as running:
        yield running


def test_clients_that_hang_on_either_transport_do_not_delay_the_end(town):
    service = town.service
    hung = [half_a_post(service) for _ in range(5)]
    requests = queue.SimpleQueue()
    requests.put(ingest_pb2.StreamScansRequest(open=ingest_pb2.Open(session=SESSION)))
    with grpc.insecure_channel(service.grpc_target) as channel:
        call = ingest_pb2_grpc.IngestServiceStub(channel).StreamScans(iter(requests.get, None), timeout=PATIENCE_S)
        assert next(call).opened.committed_seq == 0
        began_s = time.monotonic()
        service.send(signal.SIGTERM)
        # The stream is told to leave; the client takes no notice and keeps its side open.
        assert next(call).HasField("drain")
        told_s = time.monotonic() - began_s
        assert service.wait_until_it_ends() == 0
        ended_s = time.monotonic() - began_s
        requests.put(None)
    for connection in hung:
        connection.close()
    assert in_time(told_s, 2.0) and in_time(ended_s, DRAIN_S + 10.0)


def test_new_work_is_refused_while_old_work_ends(town):
    assert town.http.get("/livez").status_code == 200  # a connection that is kept
    hung = half_a_post(town.service)  # what the drain waits for
    town.service.send(signal.SIGTERM)
    town.service.wait_for("draining")
    try:
        answer = town.http.post("/v1/maps", json={"map_id": "late"})
        assert (answer.status_code, answer.json()["reason"]) == (503, "DRAINING")
        assert answer.headers["retry-after"]
    except httpx.TransportError:
        pass  # refused before HTTP: as good
    hung.close()
    assert town.service.wait_until_it_ends() == 0
