"""What clients may hold open, how slowly they may send, and under which names they may ask (rows H07, H10)."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
import ssl
import threading
from dataclasses import dataclass, replace
from urllib.parse import quote

import httpx
import pytest
import trustme
import uvicorn

from revisit.formats import QUANTISED, encode_quantised
from revisit.service.capacity.byte_budget import ByteBudget
from revisit.service.capacity.limits import ArrivalRates
from revisit.service.edge.connections import UnauthenticatedConnections
from revisit.service.rest.app import create_app
from revisit.service.rest.door import AGAIN_S
from revisit.service.rest.door import PATIENCE_S as PATIENCE_AT_THE_DOOR_S
from revisit.service.rest.limits import HttpLimits
from revisit.service.rest.listening import ListeningServer
from revisit.service.rest.slow_clients import (
    HEAD_BYTES,
    HEAD_S,
    PIPELINED,
    REST_S,
    STALLED_S,
    WRITE_BYTES,
    WRITE_S,
    DeadlineProtocol,
    uvicorn_limits,
)
from tests.support.clocked_loop import ClockedLoop
from tests.support.credentials import a_key
from tests.support.handshakes import half_hello
from tests.support.patience import PATIENCE_S, eventually
from tests.support.service_world import cloud_points, memory_world

NAMES = frozenset({"robots.example"})


class FewConnections(DeadlineProtocol):
    most_connections = 3


@dataclass(frozen=True)
class HttpServer:
    """The HTTP side on a free port."""

    server: uvicorn.Server
    loop: ClockedLoop
    address: tuple[str, int]

    @property
    def url(self) -> str:
        return f"http://{self.address[0]}:{self.address[1]}"

    def connected(self) -> socket.socket:
        connection = socket.create_connection(self.address)
        connection.settimeout(PATIENCE_S)
        return connection

    def answers(self) -> None:
        """A request on a connection of its own is answered: what came in before it has been read."""
        assert httpx.get(f"{self.url}/livez", trust_env=False).status_code == 200

    def connections(self) -> list[DeadlineProtocol]:
        return list(self.server.server_state.connections)


@contextlib.contextmanager
def http_server(
    limits=HttpLimits(),
    hosts=frozenset(),
    budget=ByteBudget(),
    unauthenticated=None,
    tls=None,
    use_cases=None,
    **settings,
):
    """Serve until the block ends."""
    use_cases = replace(use_cases or memory_world().use_cases, budget=budget)
    listener = socket.create_server(("127.0.0.1", 0))
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 65_536)
    app = create_app(use_cases, limits, hosts=hosts)
    own = {"ssl_context_factory": tls and (lambda *_: tls), **uvicorn_limits(), **settings}
    server = ListeningServer(uvicorn.Config(app, log_config=None, **own), listener, unauthenticated)
    with contextlib.closing(ClockedLoop()) as loop:
        serving = server.serve()
        thread = threading.Thread(target=lambda: loop.run_until_complete(serving), daemon=True)
        thread.start()
        eventually(lambda: server.started, "the server does not start")
        try:
            yield HttpServer(server, loop, listener.getsockname())
        finally:
            server.should_exit = True
            thread.join(PATIENCE_S)


@pytest.fixture(scope="module")
def server():
    with http_server(hosts=NAMES, budget=ByteBudget(100_000)) as running:
        yield running


def rest_of(connection):
    """All that the server says until it closes the connection."""
    said = b""
    with contextlib.suppress(ConnectionError):
        while data := connection.recv(65536):
            said += data
    return said


@pytest.mark.parametrize("begin", [b"", b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Slow: "], ids=["nothing", "half"])
def test_a_request_head_that_does_not_come_ends_the_connection(server, begin):
    with server.connected() as connection:
        connection.sendall(begin)
        server.answers()
        server.loop.forward(HEAD_S - 2.0)
        assert not gone(connection)
        server.loop.forward(3.0)
        assert rest_of(connection) == b""


def test_drops_of_a_head_do_not_move_its_deadline(server):
    with server.connected() as connection:
        connection.sendall(b"GET /livez HTTP/1.1\r\nX-Slow: ")
        for _ in range(4):
            server.answers()
            assert not gone(connection)
            server.loop.forward(HEAD_S / 4 - 0.5)
            connection.sendall(b"a")
        server.answers()
        server.loop.forward(3.0)
        assert rest_of(connection) == b""


def test_a_connection_serves_one_request_after_another_beyond_the_deadline(server):
    connection = http.client.HTTPConnection(*server.address, timeout=PATIENCE_S)
    connection.connect()
    connection.auto_open = 0
    for _ in range(4):
        connection.request("GET", "/livez")
        assert connection.getresponse().read()
        server.loop.forward(HEAD_S / 2)
    connection.close()


def test_a_body_that_trickles_is_refused_as_too_slow_and_may_be_repeated(server):
    head = (
        b"POST /v1/maps HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 1000\r\n\r\n{"
    )
    with server.connected() as connection:
        connection.sendall(head)
        server.answers()
        server.loop.forward(HttpLimits().body_grace_s - 2.0)
        assert not gone(connection)
        server.loop.forward(3.0)
        answer = connection.recv(65536)
        assert answer.startswith(b"HTTP/1.1 504")
        server.loop.forward(REST_S + 1.0)
        answer += rest_of(connection)
    assert b"DEADLINE_EXCEEDED" in answer and b"too slowly" in answer


def test_the_rest_of_a_body_that_was_refused_may_not_trickle_in_for_ever(server):
    head = b"POST /v1/nowhere HTTP/1.1\r\nHost: localhost\r\nContent-Length: 90000\r\n\r\n"
    with server.connected() as connection:
        connection.sendall(head)
        assert connection.recv(65536).startswith(b"HTTP/1.1 503")
        with contextlib.suppress(ConnectionError):
            for _ in range(3):
                connection.sendall(b"a")
                server.loop.forward(REST_S / 2)
        rest_of(connection)


def test_bodies_beyond_what_all_together_may_take_are_refused_until_later(server):
    with httpx.Client(base_url=server.url, trust_env=False) as client:
        refused = client.post("/v1/maps", content=b" " * 200_000, headers={"content-type": "application/json"})
        assert (refused.status_code, refused.json()["reason"]) == (503, "WORKERS_BUSY")
        assert refused.headers["retry-after"]
        for number in range(5):  # answered bodies are given back
            assert client.post("/v1/maps", json={"map_id": f"m{number}", "display_name": "x" * 190}).status_code == 201


def test_a_head_may_have_so_many_bytes(server):
    with httpx.Client(base_url=server.url, trust_env=False) as client:
        assert client.get("/livez", headers={"x-long": "a" * (HEAD_BYTES - 2000)}).status_code == 200
        with contextlib.suppress(httpx.RemoteProtocolError, httpx.WriteError, httpx.ReadError):
            assert client.get("/livez", headers={"x-long": "a" * (4 * HEAD_BYTES)}).status_code == 400
        assert client.get("/livez").status_code == 200


def gone(connection):
    """Whether the server has closed the connection."""
    try:
        connection.setblocking(False)
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    finally:
        connection.settimeout(PATIENCE_S)


PIPELINE = b"GET /page.js HTTP/1.1\r\nHost: localhost\r\n\r\n" * 100


class UnreadAnswers(DeadlineProtocol):
    most_pipelined = 10**6


class FewUnreadAnswers(FewConnections):
    most_pipelined = 10**6


def unread(server):
    """A connection that asks for far more than the buffers of the kernel hold, and reads nothing."""
    connection = server.connected()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.setblocking(False)

    def held_up() -> bool:
        try:
            connection.send(PIPELINE)
        except BlockingIOError:
            pass
        except ConnectionError:  # it had to make room
            return True
        own = [each for each in server.connections() if each.client == connection.getsockname()]
        return bool(own) and own[0].flow.write_paused

    eventually(held_up, "its answers do not pile up")
    return connection


def test_a_client_that_does_not_read_its_answers_is_cut_off():
    with http_server(http=UnreadAnswers) as server, unread(server):
        assert len(server.connections()) == 1
        eventually(lambda: server.loop.forward(WRITE_S) or not server.connections(), "it is not cut off")


def test_a_client_that_reads_slowly_but_steadily_gets_its_whole_answer():
    with http_server(http=UnreadAnswers) as server, server.connected() as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
        connection.sendall(PIPELINE + PIPELINE.removesuffix(b"\r\n") + b"Connection: close\r\n\r\n")
        received = 0
        while data := connection.recv(WRITE_BYTES):
            received += len(data)
            server.loop.forward(WRITE_S / 5)
    assert received > 101 * 7_000


@pytest.mark.parametrize(("method", "most"), [(b"GET", 0), (b"HEAD", 0), (b"OPTIONS", PIPELINED + 1)])
def test_requests_in_a_row_that_wait_for_no_answer_are_bounded(method, most):
    with http_server() as server, server.connected() as connection:
        connection.sendall(PIPELINE.replace(b"GET", method))
        said = rest_of(connection)
    assert said.count(b"HTTP/1.1 ") <= most
    assert (said == b"") == (most == 0)


def test_clients_that_do_not_read_keep_nobody_out():
    with http_server(HttpLimits(requests=3), http=FewUnreadAnswers) as server, contextlib.ExitStack() as held:
        for _ in range(5):
            held.enter_context(unread(server))
            server.loop.forward(STALLED_S + 0.5)
        for path in ("/livez", "/readyz", "/v1/maps"):
            assert httpx.get(server.url + path, trust_env=False).status_code == 200


def test_health_is_told_where_every_place_is_taken_and_others_are_told_when_to_come_back():
    with http_server(HttpLimits(requests=0)) as server:
        for path, status in (("/livez", 200), ("/readyz", 200), ("/v1/maps", 503)):
            answer = httpx.get(server.url + path, trust_env=False)
            assert answer.status_code == status
        assert (answer.json()["reason"], answer.headers["connection"]) == ("WORKERS_BUSY", "close")
        assert answer.headers["retry-after"]


def test_one_connection_too_many_takes_the_place_of_the_one_that_is_awaited_the_longest():
    begun = b"POST /v1/maps HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 9\r\n\r\n{"
    with http_server(http=FewConnections) as server, contextlib.ExitStack() as held:
        connections = [held.enter_context(server.connected()) for _ in range(3)]
        connections[0].sendall(begun)
        eventually(lambda: sorted(not each._idle() for each in server.connections()) == [False, False, True])
        with httpx.Client(base_url=server.url, trust_env=False) as client:
            # Silent connections go first, and the last one is that of the client itself.
            for _ in range(3):
                assert client.get("/livez", headers={"connection": "close"}).status_code == 200
        assert [gone(connection) for connection in connections] == [False, True, False]


def connected(held, server, sent, source="127.0.0.1"):
    """A connection from an address of loopback that has sent something."""
    connection = held.enter_context(
        socket.create_connection(server.address, timeout=PATIENCE_S, source_address=(source, 0))
    )
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
    unauthenticated = UnauthenticatedConnections(3)
    with http_server(unauthenticated=unauthenticated, tls=tls) as server, contextlib.ExitStack() as held:
        elsewhere = connected(held, server, begin, "127.0.0.2")
        first, *others = [connected(held, server, begin) for _ in range(5)]
        assert first.recv(1) == b""
        assert others[0].recv(1) == b""
        assert [gone(connection) for connection in (elsewhere, *others[1:])] == [False] * 4
        assert (unauthenticated.of("127.0.0.2"), unauthenticated.of("127.0.0.1")) == (1, 3)


def test_whoever_has_asked_for_something_is_no_newcomer():
    unauthenticated = UnauthenticatedConnections(2)
    with (
        http_server(unauthenticated=unauthenticated) as server,
        httpx.Client(base_url=server.url, trust_env=False) as client,
    ):
        assert client.get("/livez").status_code == 200
        with contextlib.ExitStack() as held:
            first, *_ = [connected(held, server, b"") for _ in range(3)]
            assert first.recv(1) == b""
            assert client.get("/livez").status_code == 200
            assert unauthenticated.of("127.0.0.1") == 2


@pytest.mark.parametrize(
    ("host", "status"),
    [("localhost", 200), ("LOCALHOST:8080", 200), ("127.0.0.1", 200), ("[::1]:80", 200), ("10.1.2.3", 200)]
    + [("robots.example", 200), ("Robots.Example.:8080", 200)]
    + [("evil.example", 403), ("localhost.evil.example", 403), ("127.0.0.1.evil.example", 403), ("", 403)],
)
def test_the_service_answers_only_to_names_it_knows(server, host, status):
    answer = httpx.get(f"{server.url}/livez", headers={"host": host}, trust_env=False)
    assert answer.status_code == status
    if status == 403:
        assert answer.json()["reason"] == "PERMISSION_DENIED"
        assert "REVISIT_ALLOWED_HOSTS" in answer.json()["detail"]


def test_a_star_answers_to_every_name():
    with http_server(hosts=frozenset({"*"})) as server:
        assert httpx.get(f"{server.url}/livez", headers={"host": "a.example"}, trust_env=False).status_code == 200


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
        answer = client.post(f"{path}&submap_id=words", content=body, headers={"content-type": content_type})
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


def test_a_request_with_two_lengths_ends_its_connection_and_hides_no_other(server):
    hidden = b"GET /version HTTP/1.1\r\nHost: localhost\r\n\r\n"
    head = b"POST /v1/maps HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n"
    with server.connected() as connection:
        connection.sendall(head + b"0\r\n\r\n" + hidden)
        said = rest_of(connection)
    assert said.count(b"HTTP/1.1") == 1
    assert said.startswith(b"HTTP/1.1 400")


FEW = ArrivalRates(
    anonymous_per_s=3.0, unknown_per_s=3.0, network_times=3.0, all_times=3.0, client_per_s=9.0, burst_s=1.0
)


class Still:
    """Arrivals of a service for which no time passes."""

    now_s = 0.0

    def unauthenticated(self):
        return UnauthenticatedConnections(rates=FEW, now_s=lambda: self.now_s)


def asked(server, path, source="127.0.0.1", **headers):
    """The status of a request on a connection of its own."""
    connection = http.client.HTTPConnection(*server.address, PATIENCE_S, source_address=(source, 0))
    with contextlib.closing(connection):
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.read(), answer.headers


@contextlib.contextmanager
def guarded_door():
    """A server with one key, whose time for arrivals stands still; yields it and the header with the key."""
    world = memory_world()
    key = a_key(world).text
    with http_server(unauthenticated=Still().unauthenticated(), use_cases=world.use_cases) as server:
        yield server, {"authorization": f"Bearer {key}"}


def test_connections_without_a_credential_begin_at_a_pace_and_further_ones_are_sent_away_with_an_answer():
    with guarded_door() as (server, _):
        told = [asked(server, "/v1/maps") for _ in range(5)]
        assert [status for status, *_ in told] == [401] * 3 + [429] * 2
        _, body, headers = told[-1]
        assert (json.loads(body)["reason"], headers["retry-after"], headers["connection"]) == ("RATE", "1", "close")
        assert asked(server, "/v1/maps", "127.1.0.1")[0] == 401


def test_beside_too_many_connections_of_its_address_a_known_key_is_served_and_health_is_told():
    with guarded_door() as (server, key):
        assert asked(server, "/v1/maps", **key)[0] == 200
        while asked(server, "/v1/maps")[0] != 429:
            pass
        assert {asked(server, "/livez")[0] for _ in range(9)} == {200}
        assert asked(server, "/readyz")[0] == 200
        assert [asked(server, "/v1/maps", **key)[0] for _ in range(5)] == [200] * 5


def test_a_key_that_is_not_known_yet_gets_in_beside_too_many_connections_without_one():
    with guarded_door() as (server, key):
        while asked(server, "/v1/maps")[0] != 429:
            pass
        assert asked(server, "/v1/maps", **key)[0] == 200


def test_a_known_key_that_reopens_its_connection_too_often_is_sent_away():
    with guarded_door() as (server, key):
        told = [asked(server, "/v1/maps", **key)[0] for _ in range(20)]
        assert told == [200] * (9 + 3) + [429] * 8


def test_a_connection_that_shows_nothing_waits_at_the_door_until_it_does_or_its_time_is_up():
    with guarded_door() as (server, key), contextlib.ExitStack() as held:
        while asked(server, "/v1/maps")[0] != 429:
            pass
        silent, late = connected(held, server, b""), connected(held, server, b"")
        assert asked(server, "/livez")[0] == 200
        assert not gone(silent)
        late.sendall(
            f"GET /v1/maps HTTP/1.1\r\nHost: localhost\r\nAuthorization: {key['authorization']}\r\n\r\n".encode()
        )
        assert late.recv(65536).startswith(b"HTTP/1.1 200")
        server.loop.forward(PATIENCE_AT_THE_DOOR_S + 0.5)
        assert silent.recv(1) == b""


def test_a_connection_whose_handshake_comes_too_early_waits_for_its_turn():
    still = Still()
    with (
        http_server(unauthenticated=still.unauthenticated(), tls=tls_context()) as server,
        contextlib.ExitStack() as held,
    ):
        begun = [connected(held, server, b"") for _ in range(4)]
        eventually(lambda: len(server.server._door._waiting) == 1, "none waits")
        still.now_s += 1.0
        eventually(lambda: server.loop.forward(AGAIN_S) or not server.server._door._waiting, "it is not let in")
        assert not any(gone(connection) for connection in begun)
