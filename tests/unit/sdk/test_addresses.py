"""One address of the service serves commands and programs that speak HTTP, and those that speak gRPC."""

from __future__ import annotations

import contextlib
import json
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest
import typer
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.core.errors import BadField
from revisit.sdk import addresses
from revisit.sdk.addresses import grpc_address, http_address
from revisit.sdk.client import Client


@pytest.fixture(autouse=True)
def nothing_set(monkeypatch):
    for name in ("REVISIT_HTTP", "REVISIT_GRPC", "REVISIT_URL"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def silent(monkeypatch):
    """No service answers."""
    monkeypatch.setattr(addresses, "_told", lambda *_: ("", "connection refused"))


@contextlib.contextmanager
def telling(told):
    """The URL of a service whose status says so; the paths and headers that it was asked by."""
    asked = []

    class Answer(BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append((self.path, self.headers.get("authorization")))
            self.send_response(200)
            self.send_header("content-type", "application/json")
            self.end_headers()
            self.wfile.write(json.dumps(told).encode())

        def log_message(self, *_):
            pass

    server = HTTPServer(("127.0.0.1", 0), Answer)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", asked
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@pytest.mark.parametrize(("told", "grpc"), [
    (":18511", "127.0.0.1:18511"),
    ("10.0.0.5:443", "10.0.0.5:443"),
    ("grpcs://maps.example:8443", "grpcs://maps.example:8443"),
])  # fmt: skip
def test_a_service_tells_its_grpc_side(told, grpc, monkeypatch):
    monkeypatch.setenv("REVISIT_API_KEY", "rv_key")
    with telling({"grpc_address": told}) as (http, asked):
        assert grpc_address("", http) == grpc
        monkeypatch.setenv("REVISIT_HTTP", http)
        assert grpc_address() == grpc
    assert asked == 2 * [("/v1/status", "Bearer rv_key")]


def test_an_explicit_grpc_side_wins_and_nobody_is_asked(monkeypatch):
    with telling({"grpc_address": ":18511"}) as (http, asked):
        assert grpc_address("front:443", http) == "front:443"
        monkeypatch.setenv("REVISIT_HTTP", http)
        monkeypatch.setenv("REVISIT_GRPC", "front:443")
        assert grpc_address() == "front:443"
    assert asked == []


@pytest.mark.parametrize("told", ["unix:/tmp/x", "hub:1\nb", ":", ":hub/", ":8090@hub:1", "dns://hub/hub:1", "hub"])
def test_an_answer_that_is_no_address_is_not_taken(told):
    with telling({"grpc_address": told}) as (http, _), pytest.raises(BadField, match="which is no address"):
        grpc_address("", http)


def test_the_key_of_a_client_that_asks_with_tls_is_not_sent_without_it(monkeypatch):
    monkeypatch.setattr(addresses, "_told", lambda *_: ("maps.example:8090", ""))
    assert grpc_address("", "http://maps.example") == "maps.example:8090"
    with pytest.raises(BadField, match="which has no TLS: give --grpc"):
        grpc_address("", "https://maps.example")
    assert grpc_address("maps.example:8090", "https://maps.example") == "maps.example:8090"


def test_a_service_of_an_earlier_version_tells_nothing():
    with telling({"version": "0.2.0"}) as (http, _), pytest.raises(BadField, match="it is of an earlier version"):
        grpc_address("", http)


@pytest.mark.usefixtures("silent")
@pytest.mark.parametrize(("given", "http", "grpc"), [
    ("", "http://127.0.0.1:8080", "127.0.0.1:8090"),
    ("hub", "http://hub:8080", "hub:8090"),
    ("hub:8080", "http://hub:8080", "hub:8090"),
    ("http://10.0.0.5:8080", "http://10.0.0.5:8080", "10.0.0.5:8090"),
    ("https://maps.example:8080", "https://maps.example:8080", "grpcs://maps.example:8090"),
    ("http://[::1]:8080", "http://[::1]:8080", "[::1]:8090"),
    ("[::1]", "http://[::1]:8080", "[::1]:8090"),
    ("hub/", "http://hub:8080/", "hub:8090"),
])  # fmt: skip
def test_the_grpc_side_is_beside_the_http_side(given, http, grpc, monkeypatch):
    assert (http_address(given), grpc_address("", given)) == (http, grpc)
    monkeypatch.setenv("REVISIT_HTTP", given)
    assert (http_address(), grpc_address()) == (http, grpc)


@pytest.mark.usefixtures("silent")
@pytest.mark.parametrize("http", ["http://hub:18140", "https://maps.example"])
def test_the_grpc_side_beside_another_port_is_not_guessed(http):
    with pytest.raises(BadField, match="give --grpc HOST:PORT, or REVISIT_GRPC"):
        grpc_address("", http)
    assert grpc_address("hub:18541", http) == "hub:18541"


@pytest.mark.usefixtures("silent")
def test_options_go_before_variables(monkeypatch):
    monkeypatch.setenv("REVISIT_HTTP", "http://prod:18140")
    monkeypatch.setenv("REVISIT_GRPC", "prod:18541")
    assert (http_address(), grpc_address()) == ("http://prod:18140", "prod:18541")
    assert grpc_address("", "lab") == "lab:8090"
    assert grpc_address("lab:1", "") == "lab:1"


@pytest.mark.parametrize(
    "wrong", ["ftp://hub", "http://", "hub:", "not a url", "http://hub:port", "::1", "http://hub:99999"]
)
def test_what_is_no_address_is_refused(wrong):
    with pytest.raises(BadField, match="is no address of a service"):
        http_address(wrong)


def test_the_former_variable_says_what_stands_in_its_place(monkeypatch):
    monkeypatch.setenv("REVISIT_URL", "http://hub:8080")
    for ask in (http_address, grpc_address, Client, Client.grpc):
        with pytest.raises(BadField, match="REVISIT_URL is now REVISIT_HTTP"):
            ask()
    assert http_address("lab") == "http://lab:8080"
    monkeypatch.setenv("REVISIT_HTTP", "hub")
    assert http_address() == "http://hub:8080"


def test_every_command_that_streams_takes_the_address_of_all_others():
    commands = typer.main.get_command(app).commands.values()
    options = {one.name: {option for parameter in one.params for option in parameter.opts} for one in commands}
    assert {name for name, found in options.items() if "--grpc" in found} == {"ingest", "spool", "query", "doctor"}
    assert [name for name, found in options.items() if "--grpc" in found and "--http" not in found] == []


@pytest.mark.usefixtures("silent")
def test_a_recording_is_not_sent_to_a_guessed_port(tmp_path):
    (tmp_path / "drive").mkdir()
    answer = CliRunner().invoke(app, ["ingest", str(tmp_path / "drive"), "--http", "http://127.0.0.1:18140"])
    assert "the gRPC side of http://127.0.0.1:18140 is not known" in str(answer.exception)
