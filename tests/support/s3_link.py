"""A link to an S3 server that loses, cuts, delays and refuses: one fault a request, whole requests and answers."""

from __future__ import annotations

import http.client
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from tests.support.patience import PATIENCE_S

HOP_BY_HOP = {"connection", "keep-alive", "transfer-encoding", "content-length"}


@dataclass(frozen=True)
class Request:
    """A request: the first of its method and path has number 1."""

    method: str
    path: str
    number: int


@dataclass(frozen=True)
class Fault:
    """What happens to a request. A `refused` one does not reach the server, the others do.

    `refused`: the answer is this status with this code; `answer_lost`: the connection breaks instead of the answer;
    `body_cut`: it breaks after so many bytes of the body; `body_changed`: its last byte is another one; `silent`: no
    answer until the link ends; `late_s`: seconds that the answer takes longer.
    """

    refused: tuple[int, str] | None = None
    answer_lost: bool = False
    body_cut: int | None = None
    body_changed: bool = False
    silent: bool = False
    late_s: float = 0.0


WHOLE = Fault()
SLOW_DOWN = Fault(refused=(503, "SlowDown"))


def at_first(fault: Fault, times: int = 1) -> Callable[[Request], Fault]:
    """The fault strikes each method and path so many times."""
    return lambda request: fault if request.number <= times else WHOLE


class S3Link:
    """Where clients connect to: `url`. `fault` is asked for each request and may change; `seen` are all of them."""

    def __init__(self, target: str, fault: Callable[[Request], Fault]) -> None:
        """`target` is the host:port of the server."""
        self.target = target
        self.fault = fault
        self.seen: list[Request] = []
        self.url = ""
        self.ended = threading.Event()
        self._lock = threading.Lock()

    def noted(self, method: str, path: str) -> Request:
        """The request, with its number."""
        with self._lock:
            earlier = sum((one.method, one.path) == (method, path) for one in self.seen)
            request = Request(method, path, earlier + 1)
            self.seen.append(request)
        return request

    def count(self, method: str) -> int:
        """Requests of a method so far."""
        return sum(one.method == method for one in self.seen)


@contextmanager
def s3_link(
    target: str, fault: Callable[[Request], Fault] = lambda request: WHOLE, tls: ssl.SSLContext | None = None
) -> Iterator[S3Link]:
    """A link to `target` (host:port) until the block ends; over TLS with a context, under the name localhost."""
    link = S3Link(target, fault)
    server = _Server(("127.0.0.1", 0), lambda *about: _Handler(link, *about))
    link.url = f"http://127.0.0.1:{server.server_port}"
    if tls is not None:
        server.socket = tls.wrap_socket(server.socket, server_side=True)
        link.url = f"https://localhost:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield link
    finally:
        link.ended.set()
        server.shutdown()
        thread.join(PATIENCE_S)
        server.server_close()


class _Server(ThreadingHTTPServer):
    """A client that goes away, or a server that was killed, is no error of the link."""

    daemon_threads = True

    def handle_error(self, request, client_address) -> None:
        """The connection breaks, which is what the client is told."""


class _Handler(BaseHTTPRequestHandler):
    """One connection of a client."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True

    def __init__(self, link: S3Link, *about) -> None:
        self._link = link
        super().__init__(*about)

    def _serve(self) -> None:
        body = self.rfile.read(int(self.headers.get("content-length", 0)))
        fault = self._link.fault(self._link.noted(self.command, self.path))
        if fault.refused is not None:
            status, code = fault.refused
            self._answer(status, [("content-type", "application/xml")], f"<Error><Code>{code}</Code></Error>".encode())
            return
        status, headers, answer = self._forwarded(body)
        self._link.ended.wait(PATIENCE_S if fault.silent else fault.late_s)
        if fault.answer_lost or fault.silent:
            self._break()
        else:
            changed = answer[:-1] + bytes([answer[-1] ^ 1]) if fault.body_changed and answer else answer
            self._answer(status, headers, changed, fault.body_cut)

    do_GET = do_PUT = do_POST = do_HEAD = do_DELETE = _serve

    def _forwarded(self, body: bytes) -> tuple[int, list[tuple[str, str]], bytes]:
        host, _, port = self._link.target.rpartition(":")
        server = http.client.HTTPConnection(host, int(port), timeout=PATIENCE_S)
        # The signature covers the name under which the client knows the server.
        server.request(self.command, self.path, body or None, dict(self.headers.items()))
        answer = server.getresponse()
        data = answer.read()
        server.close()
        return answer.status, [one for one in answer.getheaders() if one[0].lower() not in HOP_BY_HOP], data

    def _answer(self, status: int, headers: list[tuple[str, str]], body: bytes, cut: int | None = None) -> None:
        self.send_response_only(status)
        for name, value in headers:
            self.send_header(name, value)
        self.send_header("content-length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body[:cut])
        if cut is not None:
            self._break()

    def _break(self) -> None:
        self.close_connection = True
        self.wfile.flush()
        self.connection.shutdown(socket.SHUT_RDWR)
