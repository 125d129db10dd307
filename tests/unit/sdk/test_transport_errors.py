"""What the SDK makes of a gRPC failure that carries no details of the service."""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread

import grpc
import pytest

from revisit import Client
from revisit.sdk.errors import ApiError, Unavailable
from revisit.sdk.grpc_transport import _api_error
from revisit.sdk.retry import RetryPolicy


class Failure:
    """A failed call, as grpc tells of it."""

    def __init__(self, code: grpc.StatusCode) -> None:
        self._code = code

    def code(self) -> grpc.StatusCode:
        return self._code

    def details(self) -> str:
        return "gone"

    def trailing_metadata(self) -> tuple[tuple[str, bytes], ...]:
        return ()


@pytest.mark.parametrize("code", [grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.CANCELLED])
def test_a_service_that_ended_before_it_answered_is_asked_again(code):
    error = _api_error(Failure(code), "robot:1")
    assert isinstance(error, Unavailable)
    assert (error.retryable, error.reason) == (True, "UNREACHABLE")


def test_another_failure_is_told_as_it_is():
    error = _api_error(Failure(grpc.StatusCode.UNKNOWN), "robot:1")
    assert type(error) is ApiError
    assert (error.retryable, error.code) == (False, "UNKNOWN")


@pytest.fixture(scope="module")
def ports():
    """One port that speaks gRPC and one that speaks HTTP, neither with TLS."""
    grpc_side = grpc.server(ThreadPoolExecutor(1))
    grpc_port = grpc_side.add_insecure_port("127.0.0.1:0")
    grpc_side.start()
    with HTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as http_side:
        Thread(target=http_side.serve_forever, daemon=True).start()
        yield {"grpc": grpc_port, "http": http_side.server_port}
        http_side.shutdown()
    grpc_side.stop(None).wait()


@pytest.mark.parametrize(
    ("client", "address", "advice"),
    [
        (Client, "not a url", "begins with http://"),
        (Client, "127.0.0.1:{http}", "begins with http://"),
        (Client, "http://127.0.0.1:{grpc}", "is this the gRPC port?"),
        (Client, "https://127.0.0.1:{http}", "no TLS is spoken there"),
        (Client, "http://127.0.0.1:1", "is it running?"),
        (Client.grpc, "http://127.0.0.1:{grpc}", "is host:port, without http://"),
        (Client.grpc, "127.0.0.1:{http}", "is this the REST port?"),
        (Client.grpc, "grpcs://127.0.0.1:{grpc}", "no TLS is spoken there"),
        (Client.grpc, "127.0.0.1:1", "is it running?"),
    ],
)
def test_an_address_that_is_not_the_services_is_told_with_what_to_write_instead(ports, client, address, advice):
    with pytest.raises(Unavailable, match=re.escape(advice)):
        client(address.format(**ports), retry=RetryPolicy(attempts=1)).list_maps()
