"""A map in one file: poses with times, and clouds thinned without moving a point."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.cli.map_files import CLOUD_VOXEL_M, PlacedSubmap, as_kitti, thinned
from revisit.core.geometry import se3


def test_kitti_poses_come_with_their_times_in_the_order_of_time():
    poses = [se3.from_yaw(0.3 * n, (1.0 * n, 2.0, 0.5)) for n in range(3)]
    placed = [PlacedSubmap(f"s/{n}", (10 - n) * 1_500_000_000, pose) for n, pose in enumerate(poses)]
    lines, times = as_kitti(placed)
    read = np.loadtxt(lines.splitlines()).reshape(-1, 3, 4)
    np.testing.assert_allclose(np.loadtxt(times.splitlines()), [12.0, 13.5, 15.0])
    for found, pose in zip(read, poses[::-1], strict=True):
        np.testing.assert_allclose(found[:, 3], pose[:3, 3], atol=1e-8)
        assert Rotation.from_matrix(found[:, :3] @ pose[:3, :3].T).magnitude() < 1e-8


def test_a_thinned_cloud_keeps_one_point_a_voxel():
    points = np.random.default_rng(0).uniform(-3, 3, (20_000, 3))
    kept = points[thinned(points)]
    voxels = {tuple(voxel) for voxel in np.floor(points / CLOUD_VOXEL_M).astype(int)}
    assert {tuple(voxel) for voxel in np.floor(kept / CLOUD_VOXEL_M).astype(int)} == voxels
    assert len(kept) == len(voxels)
    assert {tuple(point) for point in kept} <= {tuple(point) for point in points}


def test_a_file_of_a_map_needs_a_name_and_a_known_format():
    runner = CliRunner()
    assert "needs --out" in runner.invoke(app, ["export", "--format", "glb"]).output
    assert "--format is one of" in runner.invoke(app, ["export", "--format", "las"]).output
