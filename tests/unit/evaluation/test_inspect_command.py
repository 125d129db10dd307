"""`revisit inspect`, and the warnings that `ingest` and `evaluate` begin with."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.cli.inspect import warn
from revisit.core.geometry import se3
from revisit.evaluation.datasets import open_recording, write_kitti


def folder(tmp_path: Path, scale: float) -> Path:
    """Twenty scans of boxes on a ground, a metre apart."""
    random = np.random.default_rng(2)
    world = np.column_stack([random.uniform(-40, 40, (8000, 2)), np.zeros(8000)])
    walls = np.column_stack(
        [random.uniform(-40, 40, 3000), np.repeat([-9.0, 9.0, 30.0], 1000), random.uniform(0, 6, 3000)]
    )
    poses = [se3.from_yaw(0.05 * step, (step, 0.0, 1.6)) for step in range(20)]
    seen = np.concatenate([world, walls])
    scans = ((scale * se3.apply(se3.inverse(pose), seen), pose, index * 10**8) for index, pose in enumerate(poses))
    write_kitti(tmp_path / "drive", scans)
    return tmp_path / "drive"


def test_a_sound_recording_has_figures_no_findings_and_a_picture(tmp_path: Path) -> None:
    drive = str(folder(tmp_path, 1.0))
    answer = CliRunner().invoke(app, ["inspect", drive, "--json", "--picture", str(tmp_path / "drive.png")])
    assert answer.exit_code == 0, answer.output
    document = json.loads(answer.stdout)
    assert document["findings"] == [] and document["figures"]["height_over_ground_m"] == pytest.approx(1.6, abs=0.05)
    assert (tmp_path / "drive.png").read_bytes().startswith(b"\x89PNG")


def test_centimetres_are_told_in_a_table_and_the_exit_status(tmp_path: Path) -> None:
    answer = CliRunner().invoke(app, ["inspect", str(folder(tmp_path, 100.0))])
    assert answer.exit_code == 2
    assert "scene_too_large" in answer.stdout and "centimetres" in answer.stdout and "0.01" in answer.stdout


def test_a_warning_names_the_likely_cause_on_stderr(tmp_path: Path, capsys) -> None:
    warn(open_recording(folder(tmp_path, 100.0)))
    said = capsys.readouterr()
    assert said.out == "" and "Likely cause: the points are in centimetres. Multiply them by 0.01." in said.err
