"""What a submap is made of: an upright frame, points within reach."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.config import SubmapConfig
from revisit.core.errors import EmptyCloud
from revisit.core.geometry import se3
from revisit.core.scan import Scan
from revisit.core.submap import Submap


def test_a_tilted_submap_is_turned_upright_and_keeps_its_place_in_the_odometry_frame():
    points = np.random.default_rng(0).normal(size=(500, 3)) * [10, 10, 3]
    T_odom_sensor = se3.from_yaw(0.7, (5, 6, 7)) @ se3.exp([0, 0, 0, 0.2, -0.3, 0])
    submap = Submap.from_cloud(Scan.validated(points, T_odom_sensor, 0))
    level = submap.levelled()
    assert np.allclose(level.T_odom_submap[2, :3], [0, 0, 1], atol=1e-9)
    before = se3.apply(submap.T_odom_submap, submap.points)
    after = se3.apply(level.T_odom_submap, level.points)
    assert np.abs(before - after).max() < 1e-4
    turned = se3.rotation_angle(se3.inverse(level.T_odom_submap) @ submap.T_odom_submap)
    assert turned == pytest.approx(np.arccos(T_odom_sensor[2, 2]), abs=1e-6)


@pytest.mark.parametrize("roll", [np.pi, np.pi - 1e-9])
def test_a_sensor_that_hangs_upside_down_is_turned_upright(roll):
    points = np.random.default_rng(0).normal(size=(500, 3)) * [10, 10, 3]
    T_odom_sensor = se3.from_yaw(0.7, (5, 6, 7)) @ se3.exp([0, 0, 0, roll, 0, 0])
    submap = Submap.from_cloud(Scan.validated(points, T_odom_sensor, 0))
    level = submap.levelled()
    assert np.allclose(level.T_odom_submap[:3, 2], [0, 0, 1], atol=1e-6)
    moved = se3.apply(level.T_odom_submap, level.points) - se3.apply(submap.T_odom_submap, submap.points)
    assert np.abs(moved).max() < 1e-4


@pytest.mark.parametrize("scene_scale", [1.0, 0.25])
def test_a_submap_that_was_turned_upright_before_still_knows_the_frame_of_its_scan(scene_scale):
    points = np.random.default_rng(0).normal(size=(500, 3)) * [10, 10, 3]
    T_odom_sensor = se3.from_yaw(0.7, (5, 6, 7)) @ se3.exp([0, 0, 0, 0.2, -0.3, 0])
    submap = Submap.from_cloud(Scan.validated(points, T_odom_sensor, 0))
    level, frame = submap.in_level_frame(scene_scale)
    again, same = submap.levelled().in_level_frame(scene_scale)
    assert np.array_equal(again.points, level.points) and np.array_equal(again.origins, level.origins)
    assert np.array_equal(same.similarity, frame.similarity)
    own = Submap.from_cloud(Scan.validated(points, T_odom_sensor, 0))
    assert np.array_equal(own.levelled(in_place=True).points, submap.levelled().points)
    assert np.abs(frame.points_to_submap(level.points) - submap.points).max() < 1e-4


def test_an_upright_submap_stays_as_it_is():
    points = np.random.default_rng(0).normal(size=(500, 3))
    submap = Submap.from_cloud(Scan.validated(points, se3.from_yaw(2.0, (1, 2, 3)), 0))
    assert submap.levelled() is submap


def test_a_jump_of_the_odometry_does_not_stretch_a_submap():
    points = np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32) * 5
    far = se3.from_yaw(0.0, (1000.0, 0, 0))
    scans = [Scan.validated(points, pose, stamp) for stamp, pose in enumerate([far, np.eye(4), np.eye(4)])]
    submap = Submap.from_scans(scans, SubmapConfig())
    assert np.linalg.norm(submap.points, axis=1).max() < 95
    assert submap.scan_count == 3


def test_a_submap_without_points_in_range_is_refused():
    points = np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32) + [500, 0, 0]
    with pytest.raises(EmptyCloud):
        Submap.from_scans([Scan.validated(points, np.eye(4), 0)], SubmapConfig())
    with pytest.raises(EmptyCloud):
        Submap.from_cloud(Scan.validated(points, np.eye(4), 0))


def test_a_window_is_described_from_the_scans_at_its_marks_in_the_frame_of_the_middle_one():
    rng = np.random.default_rng(0)
    room = rng.uniform(-20, 20, (400, 3)).astype(np.float32)
    scans = [Scan.validated(room, se3.from_yaw(0.0, (0.15 * i, 0, 0)), i) for i in range(68)]
    submap = Submap.from_window(scans, SubmapConfig(enough_returns=0))
    assert submap.stamps_ns.tolist() == [0, 7, 20, 34, 47, 60]
    np.testing.assert_array_equal(submap.T_odom_submap, scans[34].T_odom_sensor)
