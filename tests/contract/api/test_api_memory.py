"""What clients send, and do not read, is held within a budget (P10): waiting clouds keep the form they came in."""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import grpc
import httpx
import numpy as np
import pytest

from revisit import Client
from revisit.formats import KITTI
from revisit.sdk.retry import RetryPolicy
from revisit.v1 import cloud_pb2, loop_closure_pb2, loop_closure_pb2_grpc
from tests.support.figures import publish
from tests.support.patience import PATIENCE_S
from tests.support.processes import ServiceProcess

CEILING_MIB = 768.0
SEARCHES, LOCALIZES, DOWNLOADS = 8, 12, 8
FULL = (60, 150, 100)
POINTS = 1_900_000
WAIT_S = 1
TOWN = "maps/town"


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    running = ServiceProcess(tmp_path_factory.mktemp("home"), workers=0)
    with Client.grpc(running.grpc_target, retry=RetryPolicy(attempts=1)) as client, httpx_client(running) as http:
        client.create_session(client.create_map("town"), "monday")
        place = "T_odom_submap=0,0,0,0,0,0,1&stamp_ns=1"
        for submap_id, cloud in (("small", large_cloud(500)), ("large", large_cloud(POINTS))):
            answer = http.post(
                f"/v1/{TOWN}/sessions/monday/submaps?submap_id={submap_id}&{place}",
                content=cloud,
                headers={"content-type": KITTI},
            )
            assert answer.status_code == 202, answer.text
    yield running
    running.close()


def httpx_client(service):
    return httpx.Client(base_url=service.url, trust_env=False, timeout=PATIENCE_S)


def large_cloud(points: int) -> bytes:
    """A cloud of the format KITTI in which little changes, so that it compresses well."""
    table = np.zeros((points, 4), np.float32)
    table[:, 0] = np.arange(points) % 50
    table[:, 1] = np.arange(points) % 7
    table[:, 2] = np.arange(points) % 3
    return table.tobytes()


class Peak:
    """The most memory that a process had resident, looked at all the time, MiB."""

    def __init__(self, pid: int) -> None:
        self._status = Path(f"/proc/{pid}/status")
        Path(f"/proc/{pid}/clear_refs").write_text("5")

    def mib(self) -> float:
        line = next(line for line in self._status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 1024


def compressed_searches(service, count: int) -> set[int]:
    """Searches of a compressed cloud that wait for a submap which no worker describes; how they were answered."""
    body = gzip.compress(large_cloud(POINTS), 9)
    path = f"/v1/{TOWN}/submaps:search?min_seq=1&min_seq_timeout_s={WAIT_S}"
    headers = {"content-type": KITTI, "content-encoding": "gzip"}
    with httpx_client(service) as http, ThreadPoolExecutor(count) as pool:
        asked = [pool.submit(http.post, path, content=body, headers=headers) for _ in range(count)]
        return {answer.result().status_code for answer in asked}


async def _localizes(service, count: int) -> set[grpc.StatusCode]:
    data = large_cloud(15 * 2**20 // 16)
    request = loop_closure_pb2.LocalizeRequest(
        parent=TOWN,
        cloud=cloud_pb2.Cloud(encoded=cloud_pb2.EncodedCloud(content_type=KITTI, data=data)),
        min_seq=1,
        min_seq_timeout_s=WAIT_S,
    )
    async with grpc.aio.insecure_channel(service.grpc_target) as channel:
        stub = loop_closure_pb2_grpc.LoopClosureServiceStub(channel)
        calls = [stub.Localize(request, timeout=PATIENCE_S) for _ in range(count)]
        return {await call.code() for call in calls}


def localizes(service, count: int) -> set[grpc.StatusCode]:
    """Localize calls of 15 MiB; how they ended."""
    return asyncio.run(_localizes(service, count))


def unread_downloads(service, count: int) -> None:
    """Downloads of a large file, of which nothing is read."""
    address = service.url.removeprefix("http://").split(":")
    ask = f"GET /v1/{TOWN}/sessions/monday/submaps/large:download?format=ply HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with contextlib.ExitStack() as held:
        for _ in range(count):
            connection = held.enter_context(socket.create_connection((address[0], int(address[1]))))
            connection.sendall(ask.encode())
        time.sleep(WAIT_S)


SIZES = [
    pytest.param((SEARCHES, LOCALIZES, DOWNLOADS), id="small"),
    pytest.param(FULL, id="full", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("counts", SIZES)
def test_the_gateway_stays_below_its_ceiling_under_all_three_attacks_on_its_memory(service, counts):
    peak = Peak(service.pid)
    searched = compressed_searches(service, counts[0])
    after_searches = peak.mib()
    localized = localizes(service, counts[1])
    after_localizes = peak.mib()
    unread_downloads(service, counts[2])
    figures = [round(mib) for mib in (after_searches, after_localizes, peak.mib())]
    publish("memory under attack", counts=counts, peaks_mib=figures)
    assert searched <= {503, 504}
    assert localized <= {grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.DEADLINE_EXCEEDED}
    assert max(figures) < CEILING_MIB, figures
    with httpx_client(service) as http:
        assert http.get("/livez").status_code == 200
