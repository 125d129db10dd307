"""The whole method on a short simulated drive, there and back: slow, but nothing in it is a stand-in."""

from __future__ import annotations

import dataclasses
from pathlib import Path as File

import pytest

from revisit.evaluation.datasets import KittiRecording, write_kitti
from revisit.evaluation.perturbations import Perturbation
from revisit.evaluation.recording_evaluation import EvaluationOptions, evaluate
from revisit.evaluation.simulator import OS1_64, Path, build_city, drive, simulate


@pytest.mark.slow
def test_a_drive_there_and_back_closes_its_loops_at_any_heading(tmp_path: File) -> None:
    there_and_back = Path.through([[0, 0], [60, 0], [64, 2.5], [60, 5], [0, 5]])
    world = build_city([Path.through([[-40, 4], [100, 4]])], seed=2, drive=there_and_back)
    trajectory = drive(there_and_back, world.ground, spacing_m=2.0)
    sensor = dataclasses.replace(OS1_64, columns=512)
    scans = simulate(world, trajectory, sensor, seed=0)
    write_kitti(tmp_path / "drive", ((scan.points, scan.T_world_sensor, scan.stamp_ns) for scan in scans))
    options = EvaluationOptions(
        tau=10.0, stride=10.0, positive_radius=12.0, candidates=4, jobs=2,
        perturbation=Perturbation(rotate_seed=1),
    )  # fmt: skip
    summary = evaluate(KittiRecording(tmp_path / "drive"), options).summary
    assert summary["queries_with_a_loop"] >= 3
    assert summary["verified"]["recall_at_1"] == 1.0
    assert summary["poses"]["loops"] >= 3 and summary["poses"]["false"] == 0
    assert summary["poses"]["median_m"] <= 0.3 and summary["poses"]["median_deg"] <= 1.0
    assert 0.0 < summary["bytes"]["neural_map_share"] < 0.1
