"""The real service over TLS: keys, client certificates, and who is turned away (rows A01, A07, H13)."""

from __future__ import annotations

import json
import socket
import ssl
from datetime import UTC, datetime, timedelta

import pytest
import trustme

from revisit import Client
from revisit.sdk.errors import ApiError, PermissionDenied, Unauthenticated
from revisit.sdk.retry import RetryPolicy
from tests.support.patience import PATIENCE_S
from tests.support.processes import ForkedService

ONCE = RetryPolicy(attempts=1)


@pytest.fixture(scope="module")
def authority():
    return trustme.CA()


@pytest.fixture(scope="module")
def files(tmp_path_factory, authority):
    """PEM files of the service and of the authority."""
    folder = tmp_path_factory.mktemp("tls")
    server = authority.issue_cert("localhost", "127.0.0.1")
    server.cert_chain_pems[0].write_to_path(folder / "chain.pem")
    server.private_key_pem.write_to_path(folder / "key.pem")
    authority.cert_pem.write_to_path(folder / "ca.pem")
    grants = {"robot-7.example": {"tenant": "acme", "scopes": ["ingest"]}}
    (folder / "clients.json").write_text(json.dumps(grants))
    return folder


@pytest.fixture(scope="module")
def secured(tmp_path_factory, files):
    """A service with TLS, which demands client certificates over gRPC."""
    running = ForkedService(
        tmp_path_factory.mktemp("home"),
        tls_certificate=files / "chain.pem",
        tls_key=files / "key.pem",
        client_ca=files / "ca.pem",
        client_certificates=files / "clients.json",
    )
    yield running
    running.close()


def certified(monkeypatch, folder, certificate):
    """A gRPC client that shows a certificate."""
    certificate.cert_chain_pems[0].write_to_path(folder / "client.pem")
    certificate.private_key_pem.write_to_path(folder / "client-key.pem")
    monkeypatch.setenv("REVISIT_CERTIFICATE", str(folder / "client.pem"))
    monkeypatch.setenv("REVISIT_CERTIFICATE_KEY", str(folder / "client-key.pem"))


def test_https_asks_for_a_credential_and_is_trusted_by_its_authority(secured, files):
    url = secured.url.replace("http://", "https://")
    with Client(url, ca=files / "ca.pem", retry=ONCE) as client, pytest.raises(Unauthenticated):
        client.list_maps()
    with (
        Client(url, retry=ONCE) as client,
        pytest.raises(ApiError, match="signed by an unknown authority; set REVISIT_CA"),
    ):
        client.list_maps()


def test_a_plain_request_to_the_tls_port_gets_no_answer(secured):
    host, port = secured.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as connection:
        connection.sendall(b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert b"200" not in connection.recv(1000)


@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1, ssl.TLSVersion.TLSv1_1])
def test_old_versions_of_tls_are_refused(secured, files, version):
    context = ssl.create_default_context(cafile=files / "ca.pem")
    context.set_ciphers("ALL:@SECLEVEL=0")
    context.minimum_version = context.maximum_version = version
    for target in (secured.url.removeprefix("http://"), secured.grpc_target):
        host, port = target.split(":")
        with (
            socket.create_connection((host, int(port)), timeout=PATIENCE_S) as plain,
            pytest.raises((ssl.SSLError, OSError)),
        ):
            context.wrap_socket(plain, server_hostname="localhost")


def test_a_client_certificate_names_the_tenant_and_its_scopes(secured, files, authority, tmp_path, monkeypatch):
    certified(monkeypatch, tmp_path, authority.issue_cert("robot-7.example"))
    with Client.grpc(f"grpcs://{secured.grpc_target}", ca=files / "ca.pem", retry=ONCE) as client:
        assert client.create_map("town").name == "maps/town"
        with pytest.raises(PermissionDenied):
            client.loop_closures("maps/town")


def test_a_certificate_whose_name_is_not_mapped_opens_nothing(secured, files, authority, tmp_path, monkeypatch):
    certified(monkeypatch, tmp_path, authority.issue_cert("robot-8.example", common_name="robot-7.example"))
    with (
        Client.grpc(f"grpcs://{secured.grpc_target}", ca=files / "ca.pem", retry=ONCE) as client,
        pytest.raises(Unauthenticated),
    ):
        client.list_maps()


@pytest.mark.parametrize("case", ["another authority", "expired", "none"])
def test_a_certificate_that_cannot_be_trusted_or_none_ends_in_the_handshake(
    secured, files, authority, tmp_path, monkeypatch, case
):
    if case == "another authority":
        certified(monkeypatch, tmp_path, trustme.CA().issue_cert("robot-7.example"))
    if case == "expired":
        yesterday = datetime.now(UTC) - timedelta(days=1)
        certified(monkeypatch, tmp_path, authority.issue_cert("robot-7.example", not_after=yesterday))
    with (
        Client.grpc(f"grpcs://{secured.grpc_target}", ca=files / "ca.pem", retry=ONCE) as client,
        pytest.raises(ApiError) as refused,
    ):
        client.list_maps()
    assert refused.value.code == "UNAVAILABLE"


def test_files_are_for_their_owner_alone(secured, tmp_path_factory):
    home = next(path for path in tmp_path_factory.getbasetemp().glob("home*") if (path / "revisit.db").exists())
    modes = {path.relative_to(home).as_posix(): path.stat().st_mode & 0o777 for path in home.rglob("*")}
    assert modes and all(mode & 0o077 == 0 for mode in modes.values()), modes
