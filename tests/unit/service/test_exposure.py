"""Where the service may listen: every combination of address, TLS, credentials and override (promise P20)."""

from __future__ import annotations

import asyncio
import itertools
import json
import logging

import pytest
import structlog

from revisit.service.__main__ import main
from revisit.service.access_rules import access_rules
from revisit.service.composition import offline_use_cases
from revisit.service.features.keys.calls import CreateKey
from revisit.service.settings import Settings
from tests.support.made_database import made_database

ADDRESSES = {"127.0.0.1": False, "::1": False, "localhost": False, "0.0.0.0": True, "::": True, "192.0.2.7": True}


@pytest.fixture
def served(monkeypatch, tmp_path):
    """A home, and what would have been served there."""
    monkeypatch.setenv("REVISIT_HOME", str(tmp_path))
    calls = []
    monkeypatch.setattr("revisit.service.gateway.serve", lambda settings, _: calls.append(settings) or 0)
    yield calls
    structlog.reset_defaults()
    logging.basicConfig(force=True, handlers=[logging.NullHandler()])


def make_key():
    made_database(Settings().database)
    with offline_use_cases(Settings()) as use_cases:
        return asyncio.run(use_cases.keys.create(CreateKey("acme", ["query"]))).record


MATRIX = list(itertools.product(ADDRESSES, (False, True), (False, True), (False, True)))


@pytest.mark.parametrize(("host", "tls", "key", "override"), MATRIX)
def test_an_address_that_others_reach_needs_tls_and_a_key_or_an_override(
    served, monkeypatch, capsys, host, tls, key, override
):
    monkeypatch.setenv("REVISIT_HOST", host)
    monkeypatch.setenv("REVISIT_INSECURE_BIND", str(override))
    if tls:
        monkeypatch.setenv("REVISIT_TLS_CERTIFICATE", "chain.pem")
        monkeypatch.setenv("REVISIT_TLS_KEY", "key.pem")
    if key:
        make_key()
    allowed = not ADDRESSES[host] or override or (tls and key)
    assert main(["serve"]) == (0 if allowed else 78)
    assert len(served) == allowed
    said = capsys.readouterr().err
    assert ("TLS (" in said) == (not allowed and not tls)
    assert ("an API key" in said) == (not allowed and not key)


def test_a_revoked_key_counts_as_none(served, monkeypatch, capsys):
    monkeypatch.setenv("REVISIT_HOST", "0.0.0.0")
    monkeypatch.setenv("REVISIT_TLS_CERTIFICATE", "chain.pem")
    monkeypatch.setenv("REVISIT_TLS_KEY", "key.pem")
    record = make_key()
    with offline_use_cases(Settings()) as use_cases:
        asyncio.run(use_cases.keys.revoke(record.key_id))
    assert main(["serve"]) == 78
    assert "an API key" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({"TLS_CERTIFICATE": "a"}, "belong together"),
        ({"TLS_KEY": "a"}, "belong together"),
        ({"CLIENT_CA": "a"}, "needs REVISIT_TLS_CERTIFICATE"),
        ({"TLS_CERTIFICATE": "a", "TLS_KEY": "b", "CLIENT_CERTIFICATES": "c"}, "needs REVISIT_CLIENT_CA"),
        ({"JWT": "/nowhere/issuer.json"}, "REVISIT_JWT: /nowhere/issuer.json cannot be read"),
        ({"AUTHENTICATION": "off"}, "REVISIT_AUTHENTICATION"),
    ],
)
def test_settings_that_do_not_fit_together_stop_the_start(served, monkeypatch, capsys, variables, message):
    for name, value in variables.items():
        monkeypatch.setenv(f"REVISIT_{name}", value)
    assert main(["serve"]) == 78
    assert message in capsys.readouterr().err
    assert not served


ISSUER = {"issuer": "https://id.example", "audience": "revisit", "keys": "https://id.example/jwks.json"}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"keys": "http://id.example/k"}, "https URL"),
        ({"keys": "https://x.example/k"}, "https URL"),
        ({"audience": ""}, "REVISIT_JWT.audience"),
        ({"max_lifetime_s": 0}, "REVISIT_JWT.max_lifetime_s"),
        ({"lifetime_s": 60}, "REVISIT_JWT.lifetime_s"),
    ],
)
def test_an_issuer_of_tokens_that_cannot_be_trusted_stops_the_start(
    served, monkeypatch, capsys, tmp_path, changed, message
):
    (tmp_path / "issuer.json").write_text(json.dumps({**ISSUER, **changed}))
    monkeypatch.setenv("REVISIT_JWT", str(tmp_path / "issuer.json"))
    assert main(["serve"]) == 78
    assert message in capsys.readouterr().err
    assert not served


def test_an_issuer_of_tokens_stands_in_for_keys(served, monkeypatch, tmp_path):
    (tmp_path / "issuer.json").write_text(json.dumps(ISSUER))
    monkeypatch.setenv("REVISIT_JWT", str(tmp_path / "issuer.json"))
    monkeypatch.setenv("REVISIT_HOST", "0.0.0.0")
    monkeypatch.setenv("REVISIT_TLS_CERTIFICATE", "chain.pem")
    monkeypatch.setenv("REVISIT_TLS_KEY", "key.pem")
    assert main(["serve"]) == 0
    assert access_rules(served[0]).tokens is not None
