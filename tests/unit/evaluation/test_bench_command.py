"""`revisit bench`: exit statuses, what is shown, and what is passed on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.evaluation import benchmark, recognition_benchmark
from revisit.evaluation.benchmark import Metric
from revisit.evaluation.protocols.benchmark_plan import BenchmarkPlan, RecordedDrive

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


@pytest.mark.parametrize("command", [["bench"], ["bench", "run"]])
def test_a_regression_is_named_and_a_check_ends_with_status_1(asked: list[bool], command: list[str]) -> None:
    assert CliRunner().invoke(app, command).exit_code == 0
    result = CliRunner().invoke(app, [*command, "--check"])
    assert result.exit_code == 1 and asked == [False, False]
    assert "surface_error_median" in result.stdout and "worse: surface_error_median" in result.stdout


@pytest.mark.parametrize("command", [["bench", "--update"], ["bench", "run", "--update"]])
def test_updating_writes_the_baseline_and_succeeds(asked: list[bool], command: list[str]) -> None:
    assert CliRunner().invoke(app, command).exit_code == 0
    assert asked == [True]


def test_json_names_every_metric_and_holds_no_infinity(asked: list[bool]) -> None:
    document = json.loads(CliRunner().invoke(app, ["bench", "--json"]).stdout)
    assert [metric["key"] for metric in document["metrics"]] == ["surface_error_median", "describe"]
    assert document["metrics"][1]["tolerance"] is None and document["regressions"] == ["surface_error_median: worse"]


@pytest.fixture
def plans(monkeypatch: pytest.MonkeyPatch) -> list[BenchmarkPlan]:
    """Replaces the run; collects the plans."""
    collected: list[BenchmarkPlan] = []

    def run(plan: BenchmarkPlan, report: object) -> tuple[list[object], tuple[Path, Path]]:
        collected.append(plan)
        return [], (plan.folder / "recognition.md", plan.folder / "recognition.html")

    monkeypatch.setattr(recognition_benchmark, "run_recognition_bench", run)
    return collected


def recognition(*words: str) -> int:
    return CliRunner().invoke(app, ["bench", "recognition", *words]).exit_code


def test_the_named_drives_and_protocols_are_run(plans: list[BenchmarkPlan], tmp_path: Path) -> None:
    assert recognition("--out", str(tmp_path), "--drives", "centre-os1", "--protocols", "online, rotation") == 0
    (plan,) = plans
    assert [drive.name for drive in plan.drives] == ["centre-os1"]  # type: ignore[attr-defined]  # simulated
    assert plan.protocols == ("online", "rotation")
    assert plan.folder == tmp_path and plan.recordings == tmp_path / "recordings"


def test_ones_own_recordings_take_the_place_of_the_simulated_ones(plans: list[BenchmarkPlan], tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("a", "b")]
    for folder in folders:
        folder.mkdir()
    words = ["--recording", str(folders[0]), "--sessions", str(folders[0]), str(folders[1]), "--format", "nclt"]
    assert recognition(*words) == 0
    (plan,) = plans
    first, second = (RecordedDrive(folder, "nclt") for folder in folders)
    assert list(plan.drives) == [first] and list(plan.sessions) == [(first, second)]


def test_lengths_that_were_given_replace_those_of_the_bench(plans: list[BenchmarkPlan], tmp_path: Path) -> None:
    words = ["--tau", "5", "--min-index-gap", "7", "--positive-radius", "4"]
    assert recognition("--out", str(tmp_path), *words) == 0
    (plan,) = plans
    assert (plan.submap.tau, plan.submap.stride) == (5.0, 10.0)
    assert (plan.loops.min_index_gap, plan.loops.positive_radius_m) == (7, 4.0)


@pytest.mark.parametrize("words", [["--drives", "mars"], ["--protocols", "online,luck"], ["--format", "tape"]])
def test_unknown_names_are_refused(plans: list[BenchmarkPlan], words: list[str]) -> None:
    assert recognition(*words) == 1 and plans == []
