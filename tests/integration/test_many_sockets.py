"""Half TLS hellos on either port, more than the soft limit of open files, keep nobody out (P22)."""

from __future__ import annotations

import contextlib
import resource
import selectors
import socket
import ssl
import time
from pathlib import Path

import httpx
import pytest
import trustme

from tests.support.figures import publish
from tests.support.handshakes import half_hello
from tests.support.processes import ServiceProcess

SOFT = 1024
SOCKETS = 1100
CLOSED_WITHIN_S = 15.0
SLOWEST_S = 2.0


pytestmark = pytest.mark.skipif(
    resource.getrlimit(resource.RLIMIT_NOFILE)[1] < 4 * SOFT, reason="the hard limit of open files leaves no room"
)


class SmallProcess(ServiceProcess):
    """A service that is started as shells and containers do: with a soft limit of 1,024 open files."""

    launcher = ("prlimit", f"--nofile={SOFT}:", "--")


@pytest.fixture(scope="module")
def authority():
    return trustme.CA()


@pytest.fixture(scope="module")
def service(tmp_path_factory, authority):
    folder = tmp_path_factory.mktemp("tls")
    server = authority.issue_cert("localhost", "127.0.0.1")
    server.cert_chain_pems[0].write_to_path(folder / "chain.pem")
    server.private_key_pem.write_to_path(folder / "key.pem")
    running = SmallProcess(folder / "home", workers=0, tls_certificate=folder / "chain.pem", tls_key=folder / "key.pem")
    yield running
    running.close()


def slowest_answer_s(service, authority) -> float:
    """The slowest of a few answers on connections of their own."""
    context, slowest_s = ssl.create_default_context(), 0.0
    authority.configure_trust(context)
    for _ in range(5):
        began_s = time.monotonic()
        with httpx.Client(base_url=service.url.replace("http", "https"), verify=context, trust_env=False) as http:
            assert http.get("/livez").status_code == 200
        slowest_s = max(slowest_s, time.monotonic() - began_s)
    return slowest_s


@pytest.mark.parametrize("port", ["http", pytest.param("grpc", marks=pytest.mark.slow)])
def test_beginnings_of_handshakes_beyond_the_soft_limit_keep_nobody_out(service, authority, port):
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (4 * SOFT, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
    address = service.url.removeprefix("http://") if port == "http" else service.grpc_target
    host, _, number = address.rpartition(":")
    waiting = selectors.DefaultSelector()
    try:
        with contextlib.ExitStack() as held:
            beginning = half_hello()
            for _ in range(SOCKETS):
                connection = held.enter_context(socket.create_connection((host, int(number)), timeout=10))
                connection.send(beginning)
                waiting.register(connection, selectors.EVENT_READ)
            slowest_s, began_s = slowest_answer_s(service, authority), time.monotonic()
            held_open = len(list(Path(f"/proc/{service.pid}/fd").iterdir()))
            assert held_open > SOFT, (held_open, slowest_s)
            while waiting.get_map() and time.monotonic() < began_s + CLOSED_WITHIN_S:
                for key, _ in waiting.select(0.5):
                    with contextlib.suppress(ConnectionError):
                        if key.fileobj.recv(65536):
                            continue
                    waiting.unregister(key.fileobj)
            publish("many sockets", port=port, slowest_s=slowest_s, open_after=len(waiting.get_map()))
            assert slowest_s < SLOWEST_S
            assert not waiting.get_map()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
