"""Secrets stay out of what leaves the process (promise P21)."""

from __future__ import annotations

import io
import json
import logging
import secrets

import pytest
import structlog

from revisit.service.features.keys.calls import parse_key
from revisit.service.redaction import redacted
from revisit.service.telemetry import configure_logging
from tests.support.credentials import a_key
from tests.support.service_world import memory_world

KEY = "rv_abcdefabcdef_" + "aB3" * 14 + "x"
TOKEN = "eyJhbGciOiJSUzI1NiJ9.eyJzdWIiOiJ4In0.c2lnbmF0dXJl"
PEM = "-----BEGIN PRIVATE KEY-----\nMIIEvQIBADANBg\n-----END PRIVATE KEY-----"


@pytest.fixture
def logs(monkeypatch):
    written = io.StringIO()
    monkeypatch.setattr("sys.stderr", written)
    structlog.reset_defaults()
    configure_logging("DEBUG")
    yield written.getvalue
    structlog.reset_defaults()
    logging.basicConfig(force=True, handlers=[logging.NullHandler()])


def test_the_example_is_a_key():
    assert parse_key(KEY) is not None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (f"key {KEY}!", "key rv_abcdefabcdef_[secret]!"),
        ("signed with whsec_" + "aB3+/" * 8 + "x=.", "signed with whsec_[secret]."),
        (f"Authorization: Bearer {TOKEN}", "Authorization: Bearer [secret]"),
        ("authorization: bearer something else", "authorization: bearer [secret] else"),
        (f"token={TOKEN}&x=1", "token=[secret]&x=1"),
        (f"a {PEM} b", "a [secret] b"),
        ("maps/town has 3 submaps", "maps/town has 3 submaps"),
    ],
)
def test_what_looks_like_a_secret_is_struck_out(text, expected):
    assert redacted(text) == expected


def test_no_way_into_the_log_lets_a_secret_through(logs):
    log, library = structlog.get_logger("x"), logging.getLogger("a library")
    log.info("an event named %s", KEY)
    log.warning("value", key=KEY, nested={"deep": [KEY, TOKEN]}, pem=PEM)
    library.error("header %s", {"authorization": f"Bearer {KEY}"})
    for fail in (log.exception, library.exception):
        try:
            raise ValueError(f"cannot use {KEY} nor {TOKEN}")
        except ValueError:
            fail("failed")
    written = logs()
    assert KEY[16:] not in written and TOKEN not in written and "MIIEvQ" not in written
    assert len([json.loads(line) for line in written.splitlines()]) == 5
    assert "rv_abcdefabcdef_[secret]" in written


def test_of_a_thousand_planted_secrets_none_is_written_or_stored(logs):
    log, planted = structlog.get_logger("x"), []
    for _ in range(1000):
        planted.append(secrets.token_urlsafe(32))
        log.info("request", headers={"authorization": f"Bearer {planted[-1]}"})
    world = memory_world()
    keys = [a_key(world) for _ in range(20)]
    log.info("keys", keys=[key.text for key in keys])
    written = logs()
    stored = repr(world.context.transactions.read(lambda uow: (uow.keys.all(), uow.audit.since(0, 100))).result())
    assert not [secret for secret in planted if secret in written]
    assert not [key for key in keys if key.text[16:] in written or key.text[16:] in stored]
