"""What the SDK makes of a gRPC failure that carries no details of the service."""

from __future__ import annotations

import re
import ssl
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread
from types import SimpleNamespace

import grpc
import pytest
import trustme

from revisit import Client
from revisit.sdk.errors import ApiError, Unavailable
from revisit.sdk.grpc_transport import _api_error
from revisit.sdk.retry import RetryPolicy


class QuietServer(HTTPServer):
    """Says nothing of handshakes that its clients end."""

    def handle_error(self, request, client_address):
        pass


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


@pytest.fixture(scope="module")
def authority(tmp_path_factory):
    """An authority, and the file that holds it."""
    made = trustme.CA()
    file = tmp_path_factory.mktemp("authority") / "ca.pem"
    made.cert_pem.write_to_path(file)
    return SimpleNamespace(ca=made, file=file)


@contextmanager
def encrypted(authority, names, **validity):
    """The addresses of REST and gRPC sides that show a certificate for `names`; both answer nothing."""
    certificate = authority.ca.issue_cert(*names, **validity)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    certificate.configure_cert(context)
    pair = (certificate.private_key_pem.bytes(), certificate.cert_chain_pems[0].bytes())
    grpc_side = grpc.server(ThreadPoolExecutor(1))
    grpc_port = grpc_side.add_secure_port("127.0.0.1:0", grpc.ssl_server_credentials([pair]))
    grpc_side.start()
    with QuietServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as http_side:
        http_side.socket = context.wrap_socket(http_side.socket, server_side=True)
        Thread(target=http_side.serve_forever, daemon=True).start()
        yield {"rest": f"https://127.0.0.1:{http_side.server_port}", "grpc": f"grpcs://127.0.0.1:{grpc_port}"}
        http_side.shutdown()
    grpc_side.stop(None).wait()


YESTERDAY = datetime.now(UTC) - timedelta(days=1)


@pytest.mark.parametrize(
    ("names", "validity", "trusted", "told"),
    [
        (["127.0.0.1"], {}, False, "is signed by an unknown authority; set REVISIT_CA to its file"),
        (["robot.example"], {}, True, "is for another name than this address"),
        (["127.0.0.1"], {"not_after": YESTERDAY}, True, "has expired"),
    ],
)
def test_a_certificate_that_is_not_trusted_is_told_in_plain_words(authority, names, validity, trusted, told):
    with encrypted(authority, names, **validity) as addresses:
        for kind, make in (("rest", Client), ("grpc", Client.grpc)):
            client = make(addresses[kind], ca=authority.file if trusted else None, retry=RetryPolicy(attempts=1))
            with client, pytest.raises(Unavailable) as refused:
                client.list_maps()
            message = str(refused.value)
            assert f"the service's certificate {told}" in message and "is it running" not in message


@pytest.mark.parametrize("make", [Client, Client.grpc])
def test_a_file_of_authorities_that_cannot_be_used_is_named(make, tmp_path):
    address = "https://127.0.0.1:1" if make is Client else "grpcs://127.0.0.1:1"
    (tmp_path / "empty.pem").write_text("no certificate")
    for name, told in (("missing.pem", "No such file"), ("empty.pem", "holds no certificate")):
        with pytest.raises(OSError, match=f"REVISIT_CA.*{name}.*{told}"):
            make(address, ca=tmp_path / name)


@pytest.mark.parametrize(
    ("client", "address", "advice"),
    [
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
