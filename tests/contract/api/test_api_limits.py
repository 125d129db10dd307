"""What clients may hold open, how slowly they may send, and under which names they may ask (rows H07, H10)."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from urllib.parse import quote

import httpx
import pytest
import trustme
import uvicorn

from revisit.formats import QUANTISED, encode_quantised
from revisit.service.application.capacity.byte_budget import ByteBudget
from revisit.service.application.capacity.newcomers import Newcomers
from revisit.service.rest.app import create_app
from revisit.service.rest.limits import HttpLimits
from revisit.service.rest.listening import ListeningServer
from revisit.service.rest.slow_clients import HEAD_BYTES, PIPELINED, DeadlineProtocol, uvicorn_limits
from tests.support.handshakes import half_hello
from tests.support.service_world import cloud_points, memory_world

SHORT_S = 0.4


class ShortDeadline(DeadlineProtocol):
    head_s = SHORT_S


class FewConnections(DeadlineProtocol):
    most_connections = 3


@contextlib.contextmanager
def http_server(limits=HttpLimits(), hosts=frozenset(), budget=ByteBudget(), newcomers=None, tls=None, **settings):
    """The HTTP side on a free port; yields its address."""
    world = memory_world()
    use_cases = replace(world.use_cases, budget=budget)
    listener = socket.create_server(("127.0.0.1", 0))
    config = uvicorn.Config(
        create_app(use_cases, limits, hosts=hosts),
        log_config=None,
        ssl_context_factory=tls and (lambda *_: tls),
        **{**uvicorn_limits(), **settings},
    )
    server = ListeningServer(config, listener, newcomers)
    thread = threading.Thread(target=lambda: asyncio.run(server.serve()), daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    try:
        yield listener.getsockname()
    finally:
        server.should_exit = True
        thread.join(10)


@pytest.fixture(scope="module")
def impatient():
    """A server whose deadlines are short."""
    limits, names = HttpLimits(body_grace_s=SHORT_S), frozenset({"robots.example"})
    with http_server(limits, names, budget=ByteBudget(100_000), http=ShortDeadline, timeout_keep_alive=1) as address:
        yield address


def url(address):
    return f"http://{address[0]}:{address[1]}"


def closed_after_s(connection):
    """How long until the server closes the connection, seconds; what it said meanwhile."""
    started, said = time.monotonic(), b""
    connection.settimeout(10)
    while data := connection.recv(65536):
        said += data
    return time.monotonic() - started, said


@pytest.mark.parametrize("begin", [b"", b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Slow: "], ids=["nothing", "half"])
def test_a_request_head_that_does_not_come_ends_the_connection(impatient, begin):
    with socket.create_connection(impatient) as connection:
        connection.sendall(begin)
        waited_s, said = closed_after_s(connection)
    assert SHORT_S / 2 < waited_s < 5
    assert said == b""


def test_drops_of_a_head_do_not_move_its_deadline(impatient):
    with socket.create_connection(impatient) as connection:
        started = time.monotonic()
        with contextlib.suppress(OSError):
            connection.sendall(b"GET /livez HTTP/1.1\r\nX-Slow: ")
            while time.monotonic() - started < 5:
                connection.sendall(b"a")
                time.sleep(0.05)
        assert SHORT_S / 2 < time.monotonic() - started < 3


def test_a_connection_serves_one_request_after_another_beyond_the_deadline(impatient):
    with httpx.Client(base_url=url(impatient), trust_env=False) as client:
        for _ in range(4):
            assert client.get("/livez").status_code == 200
            time.sleep(SHORT_S / 2)


def test_a_body_that_trickles_is_refused_as_too_slow_and_may_be_repeated(impatient):
    head = (
        b"POST /v1/maps HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 1000\r\n\r\n{"
    )
    with socket.create_connection(impatient) as connection:
        connection.sendall(head)
        waited_s, said = closed_after_s(connection)
    assert SHORT_S / 2 < waited_s < 5
    assert said.startswith(b"HTTP/1.1 504")
    assert b"DEADLINE_EXCEEDED" in said and b"too slowly" in said


def test_the_rest_of_a_body_that_was_refused_may_not_trickle_in_for_ever(impatient):
    head = b"POST /v1/nowhere HTTP/1.1\r\nHost: localhost\r\nContent-Length: 90000\r\n\r\n"
    with socket.create_connection(impatient) as connection:
        started = time.monotonic()
        with contextlib.suppress(OSError):
            connection.sendall(head)
            while time.monotonic() - started < 6:
                connection.sendall(b"a")
                time.sleep(0.05)
        assert time.monotonic() - started < 5


def test_bodies_beyond_what_all_together_may_take_are_refused_until_later(impatient):
    with httpx.Client(base_url=url(impatient), trust_env=False) as client:
        refused = client.post("/v1/maps", content=b" " * 200_000, headers={"content-type": "application/json"})
        assert (refused.status_code, refused.json()["reason"]) == (503, "WORKERS_BUSY")
        assert refused.headers["retry-after"]
        for number in range(5):  # answered bodies are given back
            assert client.post("/v1/maps", json={"map_id": f"m{number}", "display_name": "x" * 190}).status_code == 201


def test_a_head_may_have_so_many_bytes(impatient):
    with httpx.Client(base_url=url(impatient), trust_env=False) as client:
        assert client.get("/livez", headers={"x-long": "a" * (HEAD_BYTES - 2000)}).status_code == 200
        with contextlib.suppress(httpx.RemoteProtocolError, httpx.WriteError, httpx.ReadError):
            assert client.get("/livez", headers={"x-long": "a" * (4 * HEAD_BYTES)}).status_code == 400
        assert client.get("/livez").status_code == 200


def gone(connection):
    """Whether the server has closed the connection."""
    try:
        connection.settimeout(0.0)
        return connection.recv(1) == b""
    except BlockingIOError:
        return False


PIPELINE = b"GET /page.js HTTP/1.1\r\nHost: localhost\r\n\r\n" * 100


class UnreadAnswers(DeadlineProtocol):
    write_s = SHORT_S
    most_pipelined = 10**6
    lost = threading.Event()

    def connection_lost(self, exc):
        self.lost.set()
        super().connection_lost(exc)


class FewUnreadAnswers(FewConnections):
    most_pipelined = 10**6


def unread(address):
    """A connection that asks for far more than the buffers of the kernel hold, and reads nothing."""
    connection = socket.create_connection(address)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.setblocking(False)
    give_up_s = time.monotonic() + 3.0
    while time.monotonic() < give_up_s:
        try:
            connection.send(PIPELINE)
        except BlockingIOError:
            time.sleep(0.1)
        except ConnectionError:
            break
    return connection


def test_a_client_that_does_not_read_its_answers_is_cut_off():
    UnreadAnswers.lost.clear()
    with http_server(http=UnreadAnswers) as address, unread(address):
        assert UnreadAnswers.lost.wait(60.0)


def test_a_client_that_reads_slowly_but_steadily_gets_its_whole_answer():
    with http_server(http=UnreadAnswers) as address, socket.create_connection(address) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
        connection.sendall(PIPELINE + PIPELINE.removesuffix(b"\r\n") + b"Connection: close\r\n\r\n")
        received = 0
        while data := connection.recv(32768):
            received += len(data)
            time.sleep(0.01)
    assert received > 101 * 7_000


@pytest.mark.parametrize(("method", "most"), [(b"GET", 0), (b"HEAD", 0), (b"OPTIONS", PIPELINED + 1)])
def test_requests_in_a_row_that_wait_for_no_answer_are_bounded(method, most):
    with http_server() as address, socket.create_connection(address, timeout=60) as connection:
        connection.sendall(PIPELINE.replace(b"GET", method))
        said = b""
        with contextlib.suppress(ConnectionError):
            while data := connection.recv(65536):
                said += data
    assert said.count(b"HTTP/1.1 ") <= most
    assert (said == b"") == (most == 0)


def test_clients_that_do_not_read_keep_nobody_out():
    with http_server(HttpLimits(requests=3), http=FewUnreadAnswers) as address, contextlib.ExitStack() as held:
        with ThreadPoolExecutor(5) as pool:
            for made in pool.map(unread, [address] * 5):
                held.enter_context(made)
        for path in ("/livez", "/readyz", "/v1/maps"):
            assert httpx.get(url(address) + path, trust_env=False, timeout=5).status_code == 200


def test_health_is_told_where_every_place_is_taken_and_others_are_told_when_to_come_back():
    with http_server(HttpLimits(requests=0)) as address:
        for path, status in (("/livez", 200), ("/readyz", 200), ("/v1/maps", 503)):
            answer = httpx.get(url(address) + path, trust_env=False)
            assert answer.status_code == status
        assert (answer.json()["reason"], answer.headers["connection"]) == ("WORKERS_BUSY", "close")
        assert answer.headers["retry-after"]


def test_one_connection_too_many_takes_the_place_of_the_one_that_is_awaited_the_longest():
    begun = b"POST /v1/maps HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 9\r\n\r\n{"
    with http_server(http=FewConnections) as address, contextlib.ExitStack() as held:
        connections = [held.enter_context(socket.create_connection(address)) for _ in range(3)]
        connections[0].sendall(begun)
        with httpx.Client(base_url=url(address), trust_env=False) as client:
            # Silent connections go first, and the last one is that of the client itself.
            for _ in range(3):
                assert client.get("/livez", headers={"connection": "close"}).status_code == 200
        assert [gone(connection) for connection in connections] == [False, True, False]


def connected(held, address, sent, source="127.0.0.1"):
    """A connection from an address of loopback that has sent something."""
    connection = held.enter_context(socket.create_connection(address, timeout=60, source_address=(source, 0)))
    connection.sendall(sent)
    return connection


def tls_context():
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    trustme.CA().issue_cert("localhost").configure_cert(context)
    return context


@pytest.mark.parametrize(
    ("tls", "begin"),
    [(None, b""), (None, b"GET /livez HTTP/1.1\r\nX-Slow: "), (tls_context(), half_hello())],
    ids=["nothing", "half a head", "half a TLS hello"],
)
def test_newcomers_of_one_address_give_way_to_one_another_and_to_nobody_else(tls, begin):
    newcomers = Newcomers(3)
    with http_server(newcomers=newcomers, tls=tls) as address, contextlib.ExitStack() as held:
        elsewhere = connected(held, address, begin, "127.0.0.2")
        first, *others = [connected(held, address, begin) for _ in range(5)]
        assert first.recv(1) == b""
        assert others[0].recv(1) == b""
        assert [gone(connection) for connection in (elsewhere, *others[1:])] == [False] * 4
        assert (newcomers.of("127.0.0.2"), newcomers.of("127.0.0.1")) == (1, 3)


def test_whoever_has_asked_for_something_is_no_newcomer():
    newcomers = Newcomers(2)
    with http_server(newcomers=newcomers) as address, httpx.Client(base_url=url(address), trust_env=False) as client:
        assert client.get("/livez").status_code == 200
        with contextlib.ExitStack() as held:
            first, *_ = [connected(held, address, b"") for _ in range(3)]
            assert first.recv(1) == b""
            assert client.get("/livez").status_code == 200
            assert newcomers.of("127.0.0.1") == 2


@pytest.mark.parametrize(
    ("host", "status"),
    [("localhost", 200), ("LOCALHOST:8080", 200), ("127.0.0.1", 200), ("[::1]:80", 200), ("10.1.2.3", 200)]
    + [("robots.example", 200), ("Robots.Example.:8080", 200)]
    + [("evil.example", 403), ("localhost.evil.example", 403), ("127.0.0.1.evil.example", 403), ("", 403)],
)
def test_the_service_answers_only_to_names_it_knows(impatient, host, status):
    answer = httpx.get(f"{url(impatient)}/livez", headers={"host": host}, trust_env=False)
    assert answer.status_code == status
    if status == 403:
        assert answer.json()["reason"] == "PERMISSION_DENIED"
        assert "REVISIT_ALLOWED_HOSTS" in answer.json()["detail"]


def test_a_star_answers_to_every_name():
    with http_server(hosts=frozenset({"*"})) as address:
        assert httpx.get(f"{url(address)}/livez", headers={"host": "a.example"}, trust_env=False).status_code == 200


ASCII_HEADS = {
    "model/x-pcd": b"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 9\nHEIGHT 1\n"
    b"POINTS 9\nDATA ascii\n",
    "model/ply": b"ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\n"
    b"end_header\n",
}


def test_a_cloud_in_words_is_bounded_more_tightly_than_one_in_binary(http_session):
    client, path = http_session
    for content_type, head in ASCII_HEADS.items():
        body = head + b"1.25 2.5 3.75\n" * 700_000
        answer = client.post(
            f"{path}&submap_id=words", content=body, headers={"content-type": content_type}, timeout=30
        )
        assert (answer.status_code, answer.json()["reason"]) == (413, "TOO_LARGE")
        assert "binary" in answer.json()["detail"]


@pytest.fixture
def http_session(service):
    with httpx.Client(base_url=service.http, trust_env=False) as client:
        client.post("/v1/maps", json={"map_id": "limits"})
        client.post("/v1/maps/limits/sessions", json={"session_id": "s"})
        yield client, "/v1/maps/limits/sessions/s/submaps?stamp_ns=1&T_odom_submap=0,0,0,0,0,0,1"


def test_a_binary_cloud_that_happens_to_hold_such_words_is_taken(http_session):
    client, path = http_session
    body = encode_quantised(cloud_points(3))
    answer = client.post(f"{path}&submap_id=binary", content=body, headers={"content-type": QUANTISED})
    assert answer.status_code == 202


@pytest.mark.parametrize("stamp", ["1_000", "1.0", "+1", " 1", "1e3"])
def test_a_number_of_the_query_string_is_written_in_digits_alone(http_session, stamp):
    client, path = http_session
    asked = f"{path}&submap_id=digits".replace("stamp_ns=1", f"stamp_ns={quote(stamp)}")
    answer = client.post(asked, content=encode_quantised(cloud_points(3)), headers={"content-type": QUANTISED})
    assert (answer.status_code, answer.json()["field"]) == (422, "stamp_ns")


def test_a_request_with_two_lengths_ends_its_connection_and_hides_no_other(impatient):
    hidden = b"GET /version HTTP/1.1\r\nHost: localhost\r\n\r\n"
    head = b"POST /v1/maps HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n"
    with socket.create_connection(impatient) as connection:
        connection.sendall(head + b"0\r\n\r\n" + hidden)
        _, said = closed_after_s(connection)
    assert said.count(b"HTTP/1.1") == 1
    assert said.startswith(b"HTTP/1.1 400")
