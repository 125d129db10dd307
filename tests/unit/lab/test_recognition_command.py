"""`python -m lab.recognition`: the plan that its options make."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from lab.command_line import app_of
from lab.recognition import benchmark
from lab.recognition.__main__ import recognition
from lab.recognition.benchmark_plan import BenchmarkPlan, RecordedDrive


@pytest.fixture
def plans(monkeypatch: pytest.MonkeyPatch) -> list[BenchmarkPlan]:
    """Replaces the run; collects the plans."""
    collected: list[BenchmarkPlan] = []

    def run(plan: BenchmarkPlan, report: object) -> tuple[list[object], tuple[Path, Path]]:
        collected.append(plan)
        return [], (plan.folder / "recognition.md", plan.folder / "recognition.html")

    monkeypatch.setattr(benchmark, "run_recognition_bench", run)
    return collected


def exit_status(*words: str) -> int:
    return CliRunner().invoke(app_of(recognition), list(words)).exit_code


def test_the_named_drives_and_protocols_are_run(plans: list[BenchmarkPlan], tmp_path: Path) -> None:
    assert exit_status("--out", str(tmp_path), "--drives", "centre-os1", "--protocols", "online, rotation") == 0
    (plan,) = plans
    assert [drive.name for drive in plan.drives] == ["centre-os1"]  # type: ignore[attr-defined]  # simulated
    assert plan.protocols == ("online", "rotation")
    assert plan.folder == tmp_path and plan.recordings == tmp_path / "recordings"


def test_ones_own_recordings_take_the_place_of_the_simulated_ones(plans: list[BenchmarkPlan], tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("a", "b")]
    for folder in folders:
        folder.mkdir()
    words = ["--recording", str(folders[0]), "--sessions", str(folders[0]), str(folders[1]), "--format", "nclt"]
    assert exit_status(*words) == 0
    (plan,) = plans
    first, second = (RecordedDrive(folder, "nclt") for folder in folders)
    assert list(plan.drives) == [first] and list(plan.sessions) == [(first, second)]


def test_lengths_that_were_given_replace_those_of_the_bench(plans: list[BenchmarkPlan], tmp_path: Path) -> None:
    words = ["--tau", "5", "--min-index-gap", "7", "--positive-radius", "4"]
    assert exit_status("--out", str(tmp_path), *words) == 0
    (plan,) = plans
    assert (plan.submap.tau, plan.submap.stride) == (5.0, 10.0)
    assert (plan.loops.min_index_gap, plan.loops.positive_radius_m) == (7, 4.0)


@pytest.mark.parametrize("words", [["--drives", "mars"], ["--protocols", "online,luck"], ["--format", "tape"]])
def test_unknown_names_are_refused(plans: list[BenchmarkPlan], words: list[str]) -> None:
    assert exit_status(*words) == 1 and plans == []
