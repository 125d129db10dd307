"""A call of the SDK sends what httpx's own client would send, and reads the same answer."""

from __future__ import annotations

import gzip
import ssl
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread

import httpx
import pytest

from revisit.sdk.errors import ApiError, DataLoss
from revisit.sdk.http_calls import AnswerTooLarge, HttpCalls, lines_of
from revisit.sdk.map_downloads import fetch_file
from revisit.sdk.resources import MapFile
from revisit.sdk.rest_transport import NO_AUTHORITIES, RestTransport
from revisit.sdk.retry import RetryPolicy
from revisit.v1 import map_pb2

TIMEOUT = httpx.Timeout(5.0)

CALLS = {
    "get": ("GET", "/v1/maps/a", {}),
    "an empty query": ("GET", "/v1/maps/a", {"params": {}}),
    "a query": ("GET", "/v1/maps", {"params": {"page_size": 3, "view": "FULL", "flag": True, "kinds": ["a", "b"]}}),
    "json": ("POST", "/v1/maps/a/submaps:search", {"json": {"submap": "maps/a/sessions/\u00e4/submaps/b", "k": 20}}),
    "a cloud": ("POST", "/v1/x", {"content": b"\x00\x01", "params": {"seq": 1}, "headers": {"content-type": "x/y"}}),
    "nothing": ("DELETE", "/v1/maps/a", {}),
    "what must be escaped": ("GET", "/v1/maps/\u00e4 b%2Fc", {}),
}


class Echo(BaseHTTPRequestHandler):
    """Answers with a compressed body and notes what it was sent."""

    protocol_version = "HTTP/1.1"
    sent: list = []

    def handle_any(self):
        """Note the request and answer it."""
        body = self.rfile.read(int(self.headers.get("content-length", "0")))
        self.sent.append((self.requestline, self.headers.items(), body))
        answer = gzip.compress(bytes(2**20) if "bomb" in self.path else b'{"name": "maps/a"}')
        self.send_response(404 if "nowhere" in self.path else 200)
        self.send_header("content-encoding", "gzip")
        self.send_header("content-length", str(len(answer)))
        self.end_headers()
        self.wfile.write(answer)

    do_GET = do_POST = do_DELETE = handle_any

    def log_message(self, *_):
        """Say nothing."""


@pytest.fixture(scope="module")
def address():
    with HTTPServer(("127.0.0.1", 0), Echo) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.mark.parametrize("base", ["{}", "{}/behind/a/proxy/", "http://me:secret@{}"])
@pytest.mark.parametrize("case", CALLS)
def test_what_is_sent_is_what_httpx_sends(address, case, base):
    method, path, given = CALLS[case]
    base = base.format(address.removeprefix("http://") if "@" in base else address)
    headers = {"authorization": "Bearer rv_x"} if "@" not in base else {}
    Echo.sent.clear()
    with httpx.Client(base_url=base, timeout=TIMEOUT, trust_env=False, headers=headers) as reference:
        expected = reference.request(method, path, **given)
    calls = HttpCalls(base, TIMEOUT, headers, NO_AUTHORITIES)
    answers = [calls.request(method, path, **given) for _ in range(2)]
    calls.close()
    assert Echo.sent[0] == Echo.sent[1] == Echo.sent[2]
    for answer in answers:
        assert (answer.status_code, answer.json()) == (expected.status_code, expected.json())
        assert (answer.url, answer.request.method, answer.is_closed) == (expected.url, method, True)


def test_a_refusal_is_an_answer_and_no_service_is_an_error(address):
    calls = HttpCalls(address, TIMEOUT, {}, NO_AUTHORITIES)
    assert calls.request("GET", "/nowhere").status_code == 404
    calls.close()
    gone = HttpCalls("http://127.0.0.1:1", TIMEOUT, {}, NO_AUTHORITIES)
    with pytest.raises(httpx.ConnectError):
        gone.request("GET", "/")
    gone.close()


@pytest.mark.parametrize("base", ["http://{}", "http://me:secret@{}"])
def test_an_answer_is_read_up_to_a_bound(address, base):
    calls = HttpCalls(base.format(address.removeprefix("http://")), TIMEOUT, {}, NO_AUTHORITIES)
    size = len(calls.request("GET", "/bomb").content)
    assert calls.request("GET", "/bomb", most_bytes=size).is_closed
    with pytest.raises(AnswerTooLarge):
        calls.request("GET", "/bomb", most_bytes=size - 1)
    assert calls.request("GET", "/").status_code == 200
    calls.close()


def test_an_answer_beyond_the_bound_is_an_error_that_is_not_repeated(address, monkeypatch):
    monkeypatch.setattr("revisit.sdk.http_calls.HttpCalls.request.__kwdefaults__", {**KINDS, "most_bytes": 1000})
    Echo.sent.clear()
    transport = RestTransport(f"{address}/bomb", RetryPolicy(attempts=3, base_s=0.0))
    with pytest.raises(ApiError, match="more than 1000 bytes") as refused:
        transport.call("GetMap", map_pb2.GetMapRequest(name="maps/a"))
    assert (refused.value.code, len(Echo.sent)) == ("RESOURCE_EXHAUSTED", 1)
    transport.close()


KINDS = HttpCalls.request.__kwdefaults__ or {}


def test_lines_come_as_they_are_complete_and_none_without_end():
    assert list(lines_of([b"a\r\nb", b"c\n", b"\n", b"rest"])) == ["a", "bc", ""]
    with pytest.raises(AnswerTooLarge):
        list(lines_of(bytes(2**16) for _ in range(20)))


def test_a_map_file_that_does_not_end_is_not_written_to_the_disk(tmp_path):
    file = MapFile(name="maps/a/files/1", map_hash="0" * 64, size_bytes=1000)
    came = iter(bytes(300) for _ in range(10**6))
    with pytest.raises(DataLoss):
        fetch_file(file, tmp_path / "a", lambda *_: came, RetryPolicy(attempts=1))
    assert (next(came), list(tmp_path.iterdir())) == (bytes(300), [])


def test_a_client_of_an_address_without_tls_reads_no_authorities(address, monkeypatch):
    read = []
    monkeypatch.setattr(ssl, "create_default_context", lambda *_, **given: read.append(given))
    RestTransport(address, RetryPolicy()).close()
    assert read == []


@pytest.mark.parametrize("address", ["https://revisit.example.com", "HTTPS://revisit.example.com"])
def test_a_client_of_an_address_with_tls_reads_the_authorities_however_the_address_is_written(address, monkeypatch):
    read, made = [], ssl.create_default_context
    monkeypatch.setattr(ssl, "create_default_context", lambda *_, **given: read.append(given) or made())
    RestTransport(address, RetryPolicy()).close()
    assert len(read) == 1
