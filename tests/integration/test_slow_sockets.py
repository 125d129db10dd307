"""Many sockets that keep silent or trickle, on both ports (P22): all are closed in time, and others do not notice."""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import time

import httpx
import numpy as np
import pytest

from revisit import Client
from revisit.sdk.retry import RetryPolicy
from tests.support.figures import publish
from tests.support.http2 import PREFACE
from tests.support.patience import PATIENCE_S, in_time
from tests.support.processes import ForkedService

CLOSED_WITHIN_S = 15.0
SOCKETS = int(os.environ.get("REVISIT_SLOW_SOCKETS", "2000"))
SLOWEST_MS = 1000.0
ELSEWHERE = "127.0.1.1"
BODY = b"POST /v1/maps HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 999\r\n\r\n{"
BEGINNINGS = {
    ("http", "silent"): b"",
    ("http", "head"): b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Slow: ",
    ("http", "body"): BODY,
    ("grpc", "silent"): b"",
    ("grpc", "preface"): PREFACE[:10],
}


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    running = ForkedService(tmp_path_factory.mktemp("home"), workers=0)
    yield running
    running.close()


def opened(service, beginning: tuple[str, str]) -> socket.socket:
    """A socket that has sent no more than a beginning."""
    address = service.url.removeprefix("http://") if beginning[0] == "http" else service.grpc_target
    host, _, port = address.rpartition(":")
    connection = socket.create_connection((host, int(port)), timeout=PATIENCE_S)
    connection.setblocking(False)
    with contextlib.suppress(OSError):
        connection.send(BEGINNINGS[beginning])
    return connection


class Hanging:
    """Sockets that are held open until the service closes them."""

    def __init__(self) -> None:
        self.selector = selectors.DefaultSelector()
        self.closed_after_s: dict[tuple[str, str], list[float]] = {}

    def add(self, connection: socket.socket, beginning: tuple[str, str]) -> None:
        """Hold one more."""
        self.selector.register(connection, selectors.EVENT_READ, (beginning, time.monotonic()))

    def drop_closed(self, wait_s: float) -> None:
        """Note which ones the service has closed."""
        for key, _ in self.selector.select(wait_s):
            with contextlib.suppress(BlockingIOError):
                with contextlib.suppress(ConnectionError):
                    if key.fileobj.recv(65536):
                        continue
                beginning, since_s = key.data
                self.closed_after_s.setdefault(beginning, []).append(time.monotonic() - since_s)
                self.selector.unregister(key.fileobj)
                key.fileobj.close()

    @property
    def left(self) -> int:
        """How many are open."""
        return len(self.selector.get_map())


@pytest.mark.parametrize("count", [pytest.param(40), pytest.param(SOCKETS, marks=pytest.mark.slow)])
def test_sockets_that_hang_are_closed_and_no_client_is_kept_waiting(service, count):
    hanging, took_s = Hanging(), []
    with (
        # From an address of its own: new connections of one address without a key have a pace.
        httpx.Client(transport=httpx.HTTPTransport(local_address=ELSEWHERE), base_url=service.url) as http,
        Client.grpc(service.grpc_target, retry=RetryPolicy(attempts=1)) as rpc,
    ):
        for number in range(count):
            beginning = list(BEGINNINGS)[number % len(BEGINNINGS)]
            hanging.add(opened(service, beginning), beginning)
        began_all_s = time.monotonic()
        while hanging.left and time.monotonic() < began_all_s + PATIENCE_S:
            hanging.drop_closed(0.2)
            began_s = time.perf_counter()
            assert http.get("/v1/maps").status_code == 200
            assert rpc.list_maps() == []
            took_s.append(time.perf_counter() - began_s)
    longest = {" ".join(beginning): round(max(after), 1) for beginning, after in hanging.closed_after_s.items()}
    p99_ms = round(1000 * float(np.quantile(took_s, 0.99)), 1)
    publish("slow sockets", sockets=count, closed_after_s=longest, left=hanging.left, client_p99_ms=p99_ms)
    assert hanging.left == 0
    assert in_time(max(longest.values()), CLOSED_WITHIN_S)
    assert in_time(p99_ms, SLOWEST_MS)
