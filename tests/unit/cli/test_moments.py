"""Moments as people write them on the command line."""

from __future__ import annotations

import pytest
import typer
from typer.testing import CliRunner

from revisit.cli import map_changes
from revisit.cli.app import app
from revisit.cli.moments import DAY_NS, moment_ns, since_ns
from revisit.sdk.errors import DeadlineExceeded, ErrorDetails

MONDAY_NS = 20_059 * DAY_NS  # 2024-12-02


def test_a_date_is_meant_from_its_beginning_to_its_end():
    assert (since_ns("2024-12-02"), moment_ns("2024-12-02")) == (MONDAY_NS - 1, MONDAY_NS + DAY_NS - 1)
    assert (since_ns("2024-12-02T00:00"), moment_ns("2024-12-02T00:00")) == (MONDAY_NS - 1, MONDAY_NS)
    assert (since_ns(str(MONDAY_NS)), moment_ns(str(MONDAY_NS))) == (MONDAY_NS - 1, MONDAY_NS)
    assert (since_ns(""), moment_ns(""), since_ns("0")) == (0, None, 0)


@pytest.mark.parametrize("text", ["yesterday", "\u00b2", "2024-13-01", "-5"])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(typer.Exit):
        moment_ns(text)


class Comparing:
    """A client of a service whose map gets a new version with each question, and whose worker needs two of one."""

    def __init__(self) -> None:
        self.versions, self.number, self.asked = self, 0, []

    def name(self, map_):
        self.number += 1
        return f"{map_}/versions/{self.number}"

    def map_changes(self, version, **moments):
        version = self.name(version) if version.count("/") == 1 else version
        self.asked.append(version)
        if self.asked.count(version) < 2:
            raise DeadlineExceeded(ErrorDetails("DEADLINE_EXCEEDED", "NO_ANSWER", "the drives are being compared"))
        return ["all"]


def test_changes_are_asked_of_one_version_while_robots_make_others():
    client = Comparing()
    assert map_changes._found(client, "yard", 0, 0) == ["all"]
    assert client.asked == ["maps/yard/versions/1"] * 2


@pytest.mark.parametrize("asked", [["--as-of", "2024-12-02"], ["--ever"]])
@pytest.mark.parametrize("kind", ["g2o", "csv"])
def test_a_moment_is_refused_of_what_it_does_not_choose(kind, asked):
    refused = CliRunner().invoke(app, ["export", "--format", kind, "--http", "http://127.0.0.1:1", *asked])
    assert refused.exit_code == 1 and "--as-of" in refused.stderr
