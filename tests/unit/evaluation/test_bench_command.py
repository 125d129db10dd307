"""`revisit bench`: exit statuses, what is shown, and what is passed on."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.core.device import device as used_device
from revisit.core.errors import DegenerateCloud
from revisit.core.submap import Submap
from revisit.evaluation import benchmark
from revisit.evaluation.benchmark import Metric, device
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


def test_a_device_is_measured_beside_the_processor_and_what_differs_ends_with_status_1(monkeypatch):
    rows = [shown("describe_on_cpu", 150.0, "wall ms"), shown("descriptions_that_differ", 0, "submaps")]
    monkeypatch.setattr(device, "beside_the_processor", lambda name: rows)
    result = CliRunner().invoke(app, ["bench", "--device", "torch-cpu"])
    assert result.exit_code == 0 and "describe_on_cpu" in result.stdout
    rows[1] = shown("descriptions_that_differ", 2, "submaps")
    result = CliRunner().invoke(app, ["bench", "--device", "torch-cpu", "--json"])
    assert result.exit_code == 1 and json.loads(result.stdout)["metrics"][1]["value"] == 2


def test_a_device_that_is_not_there_is_not_measured():
    result = CliRunner().invoke(app, ["bench", "--device", "cuda:99"])
    assert result.exit_code == 1 and "device cuda:99" in result.stderr


def described(name: str, *_: object) -> SimpleNamespace:
    """What stands for a description: on torch's processor, that of the submap "elsewhere" is off by 2 mm."""
    off = 2e-3 * (used_device().name == "torch-cpu" and name == "elsewhere")
    neural_map = SimpleNamespace(points=SimpleNamespace(positions=np.full((5, 3), off, np.float32)))
    vector = np.array([np.cos(off), np.sin(off)])
    return SimpleNamespace(neural_map=neural_map, descriptor=SimpleNamespace(vector=vector))


def test_submaps_are_compared_between_devices(monkeypatch):
    streets = SimpleNamespace(place="place", elsewhere="elsewhere", revisit="place")
    monkeypatch.setattr(device, "two_streets", lambda: streets)
    monkeypatch.setattr(device, "describe", described)
    monkeypatch.setattr(device, "_side_by_side", lambda name, *_: shown(f"describe_by_2_on_{name}", 9.0, "wall ms"))
    taken = {metric.key: metric.value for metric in device.beside_the_processor("torch-cpu", rounds=1)}
    assert list(taken) == [
        "describe_on_cpu", "describe_on_torch-cpu", "describe_by_2_on_cpu", "describe_by_2_on_torch-cpu",
        "descriptors_apart", "descriptions_that_differ",
    ]  # fmt: skip
    assert taken["describe_on_cpu"] >= 0 and taken["descriptions_that_differ"] == 1
    assert taken["descriptors_apart"] == pytest.approx(2.0, rel=1e-3)


def test_what_processes_side_by_side_describe_is_counted(monkeypatch):
    monkeypatch.setattr(device, "WORKING_S", 0.0)
    origin, sides = np.zeros((1, 3), np.float32), np.indices((9, 9, 9)).reshape(3, -1).T.astype(np.float32)
    cube = Submap(sides, np.zeros(len(sides), np.int32), origin, np.zeros(1, np.int64), np.eye(4), np.zeros(3))
    assert device._side_by_side("cpu", [cube], 2).value < np.inf
    with pytest.raises(DegenerateCloud):
        device._side_by_side("cpu", [replace(cube, points=0.0 * sides)], 2)
    asked: list[object] = []
    monkeypatch.setattr(device, "describe", lambda submap, *_: asked.append(submap))
    told: list[int] = []
    device.count_described("cpu", ["a", "b"], 0.0, SimpleNamespace(wait=lambda: asked.append("gate")), told.append)
    assert asked == ["a", "b", "gate", "a"] and told == [1]
