"""The bad link itself, on a service that answers every byte with the same byte."""

from __future__ import annotations

import contextlib
import socket
import socketserver
import threading
import time

import pytest

from tests.faults.proxy import WHOLE, Fault, bad_link
from tests.support.patience import PATIENCE_S


class Echo(socketserver.BaseRequestHandler):
    def handle(self):
        with contextlib.suppress(ConnectionError):
            while data := self.request.recv(65_536):
                self.request.sendall(data)
        self.server.ended.set()


@pytest.fixture
def echo():
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Echo) as server:
        server.daemon_threads = True
        server.ended = threading.Event()
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server
        server.shutdown()


def target(echo) -> str:
    return f"127.0.0.1:{echo.server_address[1]}"


def connected(link) -> socket.socket:
    return socket.create_connection(("127.0.0.1", link.port), timeout=PATIENCE_S)


def received(client: socket.socket) -> tuple[bytes, bool]:
    """Everything up to the end, and whether that was a reset."""
    data = b""
    try:
        while chunk := client.recv(65_536):
            data += chunk
    except ConnectionResetError:
        return data, True
    return data, False


def test_a_whole_link_passes_everything_and_the_end_of_it(echo):
    with bad_link(target(echo)) as link, connected(link) as client:
        client.sendall(b"x" * 200_000)
        client.shutdown(socket.SHUT_WR)
        assert received(client) == (b"x" * 200_000, False)
        assert (link.connections, link.cuts) == (1, 0)


@pytest.mark.parametrize(("cut_after", "answered"), [(1, 0), (11, 1), (15, 5), (19, 9)])
def test_a_link_is_cut_at_the_byte(echo, cut_after, answered):
    """10 bytes go up and 10 come back."""
    with bad_link(target(echo), lambda: Fault(cut_after=cut_after)) as link, connected(link) as client:
        client.sendall(b"0123456789")
        data, reset = received(client)
        # A reset may overtake the bytes before it.
        assert reset
        assert b"0123456789"[:answered].startswith(data)
        assert echo.ended.wait(PATIENCE_S)
        assert link.cuts == 1


def test_a_half_open_link_is_cut_for_the_client_only(echo):
    with bad_link(target(echo), lambda: Fault(cut_after=15, half_open=True)) as link, connected(link) as client:
        client.sendall(b"0123456789")
        assert received(client)[1]
        assert not echo.ended.wait(0.2)


def test_a_silent_link_says_nothing_any_more(echo):
    with bad_link(target(echo), lambda: Fault(silent_after=0)) as link, connected(link) as client:
        client.settimeout(0.2)
        client.sendall(b"hello")
        with pytest.raises(TimeoutError):
            client.recv(1)
        assert link.cuts == 0


@pytest.mark.parametrize("fault", [Fault(delay_s=0.1), Fault(bytes_per_s=50.0)])
def test_a_slow_link_is_slow(echo, fault):
    """0.1 s each way, or 10 bytes at 50 bytes a second each way."""
    with bad_link(target(echo), lambda: fault) as link, connected(link) as client:
        started = time.monotonic()
        client.sendall(b"0123456789")
        assert client.recv(10) == b"0123456789"
        assert time.monotonic() - started >= 0.2


def test_a_fault_can_end_while_the_link_lives(echo):
    with bad_link(target(echo), lambda: Fault(cut_after=0)) as link:
        with connected(link) as client:
            client.sendall(b"a")
            assert received(client)[1]
        link.fault = lambda: WHOLE
        with connected(link) as client:
            client.sendall(b"a")
            assert client.recv(1) == b"a"


@pytest.mark.parametrize("forgotten", [False, True])
def test_a_dark_link_passes_nothing_until_it_has_healed(echo, forgotten):
    with bad_link(target(echo)) as link, connected(link) as client:
        client.sendall(b"a")
        assert client.recv(1) == b"a"
        link.dark = True
        client.sendall(b"b")
        client.settimeout(0.2)
        with pytest.raises(TimeoutError):
            client.recv(1)
        with connected(link) as late:
            late.sendall(b"c")
            link.heal(forgotten=forgotten)
            assert late.recv(1) == b"c"
        client.settimeout(PATIENCE_S)
        if forgotten:
            assert received(client) == (b"", True)
        else:
            assert client.recv(1) == b"b"
        assert link.cuts == int(forgotten)


def test_a_service_that_is_away_resets_its_clients(echo):
    # The reset may come before the connection is even reported as made.
    with bad_link("127.0.0.1:1") as link, pytest.raises(ConnectionResetError), connected(link) as client:
        client.recv(1)


def test_a_service_that_dies_while_its_client_waits_is_noticed_by_the_client():
    """Bytes that it had not read make the kernel reset the connection."""
    with (
        socket.create_server(("127.0.0.1", 0)) as listener,
        bad_link(f"127.0.0.1:{listener.getsockname()[1]}") as link,
        connected(link) as client,
    ):
        client.sendall(b"unread")
        service, _ = listener.accept()
        assert service.recv(6, socket.MSG_PEEK)
        service.close()
        assert received(client)[0] == b""
