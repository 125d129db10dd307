"""A line of the log stays one line, and shows no more of a tenant than it is told to."""

from __future__ import annotations

import json
import logging

import pytest
import structlog

from revisit.service.telemetry import configure_logging


@pytest.fixture(autouse=True)
def unconfigured():
    yield
    structlog.reset_defaults()
    logging.basicConfig(force=True, handlers=[logging.NullHandler()])


@pytest.mark.parametrize(
    "text", ["a\r\nb", "\x1b[31mred\x1b[0m", "\x00", "\u2028\u2029", "\x85", "\ud800", "\x7f", "\u202eevil", "x" * 9]
)
def test_control_characters_cannot_break_or_colour_a_line(capsys, text):
    configure_logging("INFO")
    structlog.get_logger("test").info("posted", label=text)
    logging.getLogger("library").warning("look: %s", text)
    ours, theirs = capsys.readouterr().err.split("\n")[:2]
    for line in (ours, theirs):
        assert all(" " <= character <= "\x7f" for character in line)
    assert json.loads(ours)["label"] == text
    assert json.loads(theirs)["event"] == f"look: {text}"


@pytest.mark.parametrize("who", ["tenant", "caller"])
def test_tenants_and_callers_are_named_by_a_hash_where_asked_for(capsys, who):
    configure_logging("INFO", hash_tenants=True)
    for name in ("acme", "acme", "other"):
        structlog.get_logger("test").info("posted", **{who: name})
    first, second, other = (json.loads(line)[who] for line in capsys.readouterr().err.splitlines())
    # The first twelve digits of `printf acme | sha256sum`.
    assert first == second == "822b33ad87c1"
    assert other not in (first, "other")


def test_tenants_are_named_where_it_is_not_asked_for(capsys):
    configure_logging("INFO")
    structlog.get_logger("test").info("posted", tenant="acme")
    assert json.loads(capsys.readouterr().err)["tenant"] == "acme"
