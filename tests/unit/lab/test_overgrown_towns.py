"""The overgrown test towns: more plants where no car drives, and a recording that is off by what it says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lab.worlds.overgrown_towns import as_overgrown, overgrown
from lab.worlds.towns import SimulatedDrive
from revisit.core.geometry import se3
from revisit.evaluation.simulator import HDL32, Path, build_city
from revisit.evaluation.simulator.blocks import Material
from revisit.evaluation.simulator.lidar import SimulatedScan

PLAIN = SimulatedDrive("tiny", 8_091, replace(HDL32, columns=200), ((0, 0), (1, 0)), block_m=40.0)


def test_an_overgrown_town_has_more_leaves_and_none_over_its_streets() -> None:
    town = build_city([Path.through([[0.0, 0.0], [30.0, 0.0]]), Path.through([[15.0, 0.0], [15.0, 25.0]])], 8_091)
    grown = overgrown(town, 8_091)
    leaves = [int((world.materials == Material.LEAF).sum()) for world in (town, grown)]
    assert leaves[1] > 5 * leaves[0] > 0
    others = [world.triangles[world.materials != Material.LEAF] for world in (town, grown)]
    np.testing.assert_array_equal(*others)
    middles = grown.triangles[grown.materials == Material.LEAF].mean(axis=1).astype(np.float64)
    low = middles[middles[:, 2] - town.ground.height(middles[:, :2]) < 0.5]
    assert town.ground.street_distance(low[:, :2]).min() > 4.0


def test_an_overgrown_drive_is_recorded_with_the_errors_it_states() -> None:
    drive, rng = as_overgrown(PLAIN), np.random.default_rng(0)
    points = rng.normal(size=(640, 3)).astype(np.float32) * 10.0
    scan = SimulatedScan(points, np.eye(4), 7, np.zeros(640, bool), np.repeat(np.arange(32), 20).astype(np.uint8))
    errors = []
    for index in range(200):
        seen, pose, stamp = drive._recorded(index, scan)
        errors.append(se3.log(pose))
        assert stamp == 7
    assert np.degrees(np.mean(errors, axis=0)[5]) == pytest.approx(drive.askew_deg, abs=0.02)
    assert np.std(errors, axis=0)[:3] == pytest.approx([drive.pose_noise_m] * 3, rel=0.25)
    longer = np.linalg.norm(seen, axis=1) - np.linalg.norm(points, axis=1)
    of_beam = longer.reshape(32, 20)
    assert of_beam.std(axis=1).max() < 1e-4
    assert of_beam.mean(axis=1).std() == pytest.approx(drive.beam_offset_m, rel=0.5)
    assert PLAIN._recorded(0, scan)[0] is points
