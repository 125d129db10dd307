"""`revisit audit`: the log of a data folder, listed and verified without its service."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.service.engines.local.sqlite.migration import migrate


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A data folder in which a key was made."""
    migrate(tmp_path / "revisit.db")
    assert CliRunner().invoke(app, ["keys", "create", "--home", str(tmp_path)]).exit_code == 0
    return tmp_path


def audit(home: Path, *words: str, status: int = 0) -> str:
    result = CliRunner().invoke(app, ["audit", "--home", str(home), *words])
    assert result.exit_code == status, result.output
    return result.stdout


def test_the_rows_of_the_log_are_listed(home: Path) -> None:
    (row,) = json.loads(audit(home, "--json"))
    assert "key" in row["action"].lower() and row["action"] in audit(home)


def test_a_whole_log_is_verified_and_is_the_one_that_was_noted(home: Path) -> None:
    (noted,) = re.findall(r"1:[0-9a-f]{64}", audit(home, "--verify"))
    audit(home, "--verify", "--expect", noted)
    audit(home, "--verify", "--expect", f"1:{'0' * 64}", status=1)


def test_what_was_noted_is_compared_only_where_the_log_is_verified(home: Path) -> None:
    audit(home, "--expect", f"1:{'0' * 64}", status=1)
