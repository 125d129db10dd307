"""Floods of HTTP/2 control frames on the gRPC port (row R07): the flooder is sent away, others are served."""

from __future__ import annotations

import contextlib
import socket
import struct
from pathlib import Path

import pytest

from revisit import Client
from revisit.sdk.retry import RetryPolicy
from tests.support.http2 import CANCEL, GOAWAY, OPENING, PING, RST_STREAM, SETTINGS, call_headers, frame, frames
from tests.support.patience import PATIENCE_S
from tests.support.processes import ServiceProcess

ENHANCE_YOUR_CALM = 11
FRAMES = 20_000
GROWTH_MIB = 64.0
LIST_MAPS = "/revisit.v1.MapService/ListMaps"


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    running = ServiceProcess(tmp_path_factory.mktemp("home"), workers=0)
    yield running
    running.close()


@pytest.fixture
def connection(service):
    host, _, port = service.grpc_target.rpartition(":")
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as made:
        made.sendall(OPENING)
        yield made


def rss_mib(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1]) / 1024


def test_a_flood_of_pings_is_told_to_go_away(connection):
    with contextlib.suppress(OSError):
        connection.sendall(frame(PING, bytes(8)) * 100)
    codes = [struct.unpack(">I", payload[4:8])[0] for kind, payload in frames(connection) if kind == GOAWAY]
    assert ENHANCE_YOUR_CALM in codes


def rapid_resets() -> bytes:
    calls = range(1, 2 * FRAMES, 2)
    return b"".join(call_headers(LIST_MAPS, call) + frame(RST_STREAM, CANCEL, stream=call) for call in calls)


FLOODS = {
    "pings": lambda: frame(PING, bytes(8)) * FRAMES,
    "settings": lambda: frame(SETTINGS) * FRAMES,
    "rapid resets": rapid_resets,
}


@pytest.mark.parametrize("flood", FLOODS)
def test_a_flood_leaves_the_service_with_others_and_its_memory(service, connection, flood):
    with Client.grpc(service.grpc_target, retry=RetryPolicy(attempts=1)) as other:
        other.list_maps()
        before_mib = rss_mib(service.pid)
        with contextlib.suppress(OSError):
            # Its answers are not read: a service that queued them without bound would swell.
            connection.sendall(FLOODS[flood]())
        for _ in range(20):
            assert other.list_maps() == []
        assert rss_mib(service.pid) - before_mib < GROWTH_MIB
