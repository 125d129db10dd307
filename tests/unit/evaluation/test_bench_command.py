"""`revisit bench`: exit statuses, what is shown, and what is passed on."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.evaluation import benchmark
from revisit.evaluation.benchmark import Metric
from revisit.evaluation.benchmark.metric import shown

GOOD = Metric("surface_error_median", 0.05, "m", "up", 0.1)
SHOWN = Metric("describe", 0.4, "CPU s", "up", np.inf)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Replaces the measurement; collects whether the baseline was to be written."""
    calls: list[bool] = []

    def run(update: bool = False) -> tuple[list[Metric], list[str]]:
        calls.append(update)
        return [GOOD, SHOWN], [] if update else ["surface_error_median: worse"]

    monkeypatch.setattr(benchmark, "run", run)
    return calls


def test_a_regression_is_named_and_a_check_ends_with_status_1(asked: list[bool]) -> None:
    assert CliRunner().invoke(app, ["bench"]).exit_code == 0
    result = CliRunner().invoke(app, ["bench", "--check"])
    assert result.exit_code == 1 and asked == [False, False]
    assert "surface_error_median" in result.stdout and "worse: surface_error_median" in result.stdout


def test_updating_writes_the_baseline_and_succeeds(asked: list[bool]) -> None:
    assert CliRunner().invoke(app, ["bench", "--update"]).exit_code == 0
    assert asked == [True]


def test_libraries_have_one_thread_before_anything_is_measured(
    asked: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "8")
    monkeypatch.setattr(
        benchmark, "run", lambda update: ([shown("threads", int(os.environ["OMP_NUM_THREADS"]), "")], [])
    )
    document = json.loads(CliRunner().invoke(app, ["bench", "--json"]).stdout)
    assert [metric["value"] for metric in document["metrics"]] == [1]


def test_json_names_every_metric_and_holds_no_infinity(asked: list[bool]) -> None:
    document = json.loads(CliRunner().invoke(app, ["bench", "--json"]).stdout)
    assert [metric["key"] for metric in document["metrics"]] == ["surface_error_median", "describe"]
    assert document["metrics"][1]["tolerance"] is None and document["regressions"] == ["surface_error_median: worse"]
