"""Policies of retention, the same over REST, gRPC and the command line."""

from __future__ import annotations

import itertools
import json

import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.sdk.errors import InvalidArgument, NotFound
from revisit.sdk.resources import RetentionPolicy
from tests.support.service_world import cloud_points, pose

_places = itertools.count(5_000)

ALL_OF_IT = RetentionPolicy(
    keep_scans="DESCRIBED",
    scans_after_hours=12.0,
    best_submaps=2,
    session_days=90.0,
    dropped_session_days=7.5,
    rejected_days=30.0,
    retired_days=365.0,
)
NO_SCANS = RetentionPolicy(keep_scans="NONE", scans_after_hours=24.0)


@pytest.fixture
def town(client, session):
    """A map with one described submap, of a cloud that no other map has."""
    client.wait(client.post_submap(session, "a", cloud_points(next(_places)), pose(), 1_000))
    return session.name.rpartition("/sessions/")[0]


def test_a_map_has_the_policy_of_the_service_until_it_has_its_own(client, town):
    before = client.retention(town)
    assert (before.policy, before.own, before.last_run) == (RetentionPolicy(keep_scans="ALL"), False, None)
    kept = client.set_retention(town, ALL_OF_IT)
    assert (kept.map, kept.policy, kept.own, kept.redescription) == (town, ALL_OF_IT, True, "FROM_SCANS")
    assert client.retention(town) == kept
    assert client.set_retention(town, None) == before


def test_a_policy_that_keeps_no_scans_says_what_a_later_model_has_left(client, town):
    kept = client.set_retention(town, NO_SCANS)
    assert kept.redescription == "FROM_NEURAL_MAPS"
    assert client.get_submap(f"{town}/sessions/monday/submaps/a").kept_scans == "ALL"


def test_a_dry_run_changes_nothing(client, town):
    report = client.preview_retention(town, RetentionPolicy(keep_scans="NONE"))
    (scans,) = report.rules
    assert (scans.rule, scans.submaps, scans.sessions) == ("SCANS", 1, 0) and scans.bytes > 0
    assert client.preview_retention(town).rules == ()
    assert client.retention(town).own is False


@pytest.mark.parametrize(
    ("field", "bad"),
    [
        ("scans_after_hours", -1.0),
        ("best_submaps", 0),
        ("best_submaps", 101),
        ("session_days", 0.0),
        ("dropped_session_days", 1e9),
        ("rejected_days", 0.01),
        ("retired_days", 0.0),
    ],
)
def test_values_out_of_bounds_are_refused(client, town, field, bad):
    for asked in (client.set_retention, client.preview_retention):
        with pytest.raises(InvalidArgument) as refused:
            asked(town, RetentionPolicy(**{field: bad}))
        assert refused.value.field == f"policy.{field}"


def test_a_map_that_is_not_there_has_no_policy(client):
    for asked in (client.retention, client.preview_retention, lambda name: client.set_retention(name, ALL_OF_IT)):
        with pytest.raises(NotFound):
            asked("maps/nowhere")


def test_the_command_sets_shows_and_tries_a_policy(service, client, town):
    def command(*words: str):
        asked = ["map", "retention", "--map", town.rpartition("/")[2], "--http", service.http, *words]
        return CliRunner().invoke(app, asked)

    assert "everything is kept" in command().output
    assert "1" in command("--dry-run", "--set", "scans=none").output
    assert client.retention(town).own is False
    assert "scans=24h,best=2" in command("--set", "best=2,scans=24h").output
    assert json.loads(command("--json").output)["policy"]["best_submaps"] == 2
    refused = command("--set", "scans=sometimes")
    assert refused.exit_code != 0 and "no rule of retention" in refused.output
    assert "policy of the service" in command("--unset").output
