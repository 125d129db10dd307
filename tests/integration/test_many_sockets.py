"""Half TLS hellos on either port, more than the process may have files open, keep nobody out (P22)."""

from __future__ import annotations

import contextlib
import resource
import selectors
import socket
import ssl
import time

import grpc
import httpx
import pytest
import trustme

from revisit.v1 import map_pb2, map_pb2_grpc
from tests.support.figures import publish
from tests.support.handshakes import half_hello
from tests.support.processes import ServiceProcess

SOFT = 1024
SOCKETS = 1100
ADDRESSES = 5
"""From so many they come where the bound of an address is not to be met."""

PATIENCE_S = 45.0
"""Less than the minute that uvicorn would allow a handshake."""


pytestmark = pytest.mark.skipif(
    resource.getrlimit(resource.RLIMIT_NOFILE)[1] < 4 * SOFT, reason="the hard limit of open files leaves no room"
)


class SmallProcess(ServiceProcess):
    """A service that is started as shells and containers do: with a soft limit of 1,024 open files."""

    launcher = ("prlimit", f"--nofile={SOFT}:", "--")


class TightProcess(ServiceProcess):
    """A service that cannot raise that limit."""

    launcher = ("prlimit", f"--nofile={SOFT}:{SOFT}", "--")


@pytest.fixture(scope="module")
def authority():
    return trustme.CA()


@pytest.fixture(scope="module")
def serving(tmp_path_factory, authority):
    """What starts a service with TLS."""
    folder = tmp_path_factory.mktemp("tls")
    server = authority.issue_cert("localhost", "127.0.0.1")
    server.cert_chain_pems[0].write_to_path(folder / "chain.pem")
    server.private_key_pem.write_to_path(folder / "key.pem")
    tls = {"tls_certificate": folder / "chain.pem", "tls_key": folder / "key.pem"}
    with contextlib.ExitStack() as running:
        yield lambda kind, name: running.enter_context(contextlib.closing(kind(folder / name, workers=0, **tls)))


@pytest.fixture(scope="module")
def service(serving):
    return serving(SmallProcess, "small")


@pytest.fixture(autouse=True)
def many_files():
    """This process may have more files open than the service."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (4 * SOFT, hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def slowest_answer_s(service, authority) -> float:
    """The slowest of a few answers over HTTP on connections of their own."""
    context, slowest_s = ssl.create_default_context(), 0.0
    authority.configure_trust(context)
    for _ in range(5):
        began_s = time.monotonic()
        url = service.url.replace("http", "https")
        with httpx.Client(base_url=url, verify=context, trust_env=False, timeout=60) as http:
            assert http.get("/livez").status_code == 200
        slowest_s = max(slowest_s, time.monotonic() - began_s)
    return slowest_s


def begun(held, service, port: str, addresses: int) -> list[socket.socket]:
    """`SOCKETS` connections that have sent half a hello, from so many addresses of loopback."""
    address = service.url.removeprefix("http://") if port == "http" else service.grpc_target
    host, _, number = address.rpartition(":")
    beginning, made = half_hello(), []
    for index in range(SOCKETS):
        source = (f"127.0.0.{2 + index % addresses}", 0)
        made.append(held.enter_context(socket.create_connection((host, int(number)), 60, source_address=source)))
        with contextlib.suppress(ConnectionError):
            made[-1].send(beginning)
    return made


@pytest.mark.parametrize("port", ["http", pytest.param("grpc", marks=pytest.mark.slow)])
def test_beginnings_of_handshakes_beyond_the_soft_limit_keep_nobody_out(service, authority, port):
    assert resource.prlimit(service.pid, resource.RLIMIT_NOFILE)[0] > SOFT
    waiting = selectors.DefaultSelector()
    with contextlib.ExitStack() as held:
        for connection in begun(held, service, port, ADDRESSES):
            waiting.register(connection, selectors.EVENT_READ)
        slowest_s, began_s = slowest_answer_s(service, authority), time.monotonic()
        while waiting.get_map():
            for key, _ in waiting.select(PATIENCE_S):
                with contextlib.suppress(ConnectionError):
                    if key.fileobj.recv(65536):
                        continue
                waiting.unregister(key.fileobj)
            assert time.monotonic() < began_s + PATIENCE_S, f"{len(waiting.get_map())} are open"
        publish("many sockets", port=port, slowest_s=slowest_s, closed_after_s=time.monotonic() - began_s)


@pytest.mark.parametrize("port", ["http", pytest.param("grpc", marks=pytest.mark.slow)])
def test_beginnings_of_handshakes_of_one_address_leave_room_where_the_hard_limit_is_low(serving, authority, port):
    service = serving(TightProcess, f"tight-{port}")
    with contextlib.ExitStack() as held:
        made = begun(held, service, port, 1)
        slowest_s = slowest_answer_s(service, authority)
        assert rpc_answers(service, authority)
        publish("many sockets of one address", port=port, slowest_s=slowest_s, sockets=len(made))


def rpc_answers(service, authority) -> bool:
    """Whether somebody gets in over gRPC, who tries again until a minute is over."""
    certificate = authority.cert_pem.bytes()
    target = f"localhost:{service.grpc_target.rpartition(':')[2]}"
    with grpc.secure_channel(target, grpc.ssl_channel_credentials(certificate)) as channel:
        stub = map_pb2_grpc.MapServiceStub(channel)
        return not stub.ListMaps(map_pb2.ListMapsRequest(), wait_for_ready=True, timeout=PATIENCE_S).maps
