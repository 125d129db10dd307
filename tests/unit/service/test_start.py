"""Starting: commands, refusals and logs."""

from __future__ import annotations

import json
import logging
import sqlite3

import pytest
import structlog

from service.__main__ import main
from service.adapters.sql.migration import current_revision
from service.telemetry import configure_logging


@pytest.fixture(autouse=True)
def home(monkeypatch, tmp_path):
    monkeypatch.setenv("REVISIT_HOME", str(tmp_path))
    yield tmp_path
    structlog.reset_defaults()
    logging.basicConfig(force=True, handlers=[logging.NullHandler()])


def test_migrate_makes_the_database_and_takes_it_away_again(home):
    assert main(["migrate"]) == 0
    assert current_revision(home / "revisit.db") == "0001"
    assert (home / "revisit.db").stat().st_mode & 0o077 == 0
    assert main(["migrate", "--revision", "base"]) == 0
    assert current_revision(home / "revisit.db") is None


def test_a_database_of_a_newer_version_is_refused_and_left_alone(home, capsys):
    main(["migrate"])
    with sqlite3.connect(home / "revisit.db") as connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    assert main(["migrate"]) == 78
    assert "does not fit this version" in capsys.readouterr().err
    assert current_revision(home / "revisit.db") == "9999"


def test_a_worker_without_a_database_is_refused(capsys):
    assert main(["worker"]) == 78
    assert "migrate" in capsys.readouterr().err


def test_an_unknown_log_level_is_refused(monkeypatch, capsys):
    monkeypatch.setenv("REVISIT_LOG_LEVEL", "LOUD")
    assert main(["migrate"]) == 78
    assert "LOUD" in capsys.readouterr().err


def test_logs_are_json_lines_with_the_ids_that_are_bound(capsys):
    configure_logging("INFO")
    with structlog.contextvars.bound_contextvars(request_id="r-1"):
        structlog.get_logger("test").info("posted", submap="a\nb")
    logging.getLogger("library").warning("look %s", "here")
    logging.getLogger("library").info("not this")
    ours, theirs = (json.loads(line) for line in capsys.readouterr().err.splitlines())
    assert (ours["event"], ours["request_id"], ours["submap"], ours["level"]) == ("posted", "r-1", "a\nb", "info")
    assert (theirs["event"], theirs["logger"], theirs["level"]) == ("look here", "library", "warning")
