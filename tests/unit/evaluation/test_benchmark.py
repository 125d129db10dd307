"""The benchmark: ratios to a reference work, and the works that it times."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from revisit.evaluation import benchmark
from revisit.evaluation.benchmark import timing
from revisit.evaluation.benchmark.metric import Metric, compare, shown
from revisit.evaluation.benchmark.speed import SEARCHES, searching
from revisit.evaluation.benchmark.timing import ReferenceWork, Timing, measure


def test_a_change_beyond_the_tolerance_in_the_worse_direction_is_a_regression() -> None:
    metrics = [
        Metric("slower", 1.2, "x"),
        Metric("faster", 0.5, "x"),
        shown("seconds", 9.0, "s"),
        Metric("new", 1.0, "x"),
    ]
    worse = Metric("recall", 0.7, "of loops", worse="down")
    found = compare([*metrics, worse], {"slower": 1.0, "faster": 1.0, "seconds": 1.0, "recall": 0.9})
    assert [sentence.split(":")[0] for sentence in found] == ["slower", "recall"]
    assert "baseline 1 (+20%)" in found[0]


def test_a_ratio_is_of_the_reference_before_and_after(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timing, "_cpu_seconds", lambda work: 1.0 if isinstance(work, ReferenceWork) else work())
    timings = measure({"three": lambda: 3.0, "half": lambda: 0.5}, rounds=3)
    assert timings == {"three": Timing(3.0, 3.0), "half": Timing(0.5, 0.5)}


def test_searches_of_a_made_up_map_can_be_timed() -> None:
    assert measure({"search": searching(300, 64)}, rounds=1)["search"].seconds > 0.0


def test_of_a_search_the_time_of_one_is_told_and_an_update_writes_what_was_measured(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    measured = benchmark._timed({"search_10": Timing(2.0, 10.0), "describe": Timing(2.0, 10.0)})
    assert [metric.value for metric in measured] == [2000.0 / SEARCHES, 10.0 / SEARCHES, 2000.0, 10.0]
    monkeypatch.setattr(benchmark, "measure_all", lambda: measured)
    file = tmp_path / "baseline.json"
    assert benchmark.run(file, update=True) == (measured, [])
    assert json.loads(file.read_text())["describe_ratio"] == 10.0


def test_a_peer_that_another_machine_slows_down_is_no_regression() -> None:
    slow = Timing(seconds=1.0, ratio=20.0)
    metrics = benchmark._timed({"describe": slow, "describe_scan-context": slow, "verify_small_gicp": slow})
    known = dict.fromkeys(("describe_ratio", "describe_scan-context_ratio", "verify_small_gicp_ratio"), 10.0)
    assert [told.partition(":")[0] for told in benchmark.compare(metrics, known)] == ["describe_ratio"]
