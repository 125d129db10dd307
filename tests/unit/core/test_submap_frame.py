"""What a submap is made of: an upright frame, points within reach."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.config import SubmapConfig
from revisit.core.errors import EmptyCloud
from revisit.core.geometry import se3
from revisit.core.relocalisation.view_window import ViewWindow
from revisit.core.scan import Scan
from revisit.core.submap import Submap


def square(normal_axis: int, at: float, extent: float, count: int) -> np.ndarray:
    """Points of a square of 2 `extent` side, a centimetre thick, square to an axis."""
    rng = np.random.default_rng([7, normal_axis, int(at + 50)])
    points = rng.uniform(-extent, extent, (count, 3))
    points[:, normal_axis] = at + rng.normal(0.0, 0.01, count)
    return points


GROUND = square(2, -1.7, 15.0, 20_000)
WALLS = np.concatenate([square(0, 9.0, 6.0, 4000), square(1, -7.0, 6.0, 4000), square(1, 8.0, 6.0, 4000)])


def leaning(degrees: float, towards: float = 40.0) -> np.ndarray:
    """T_odom_level (4, 4) of an odometry whose z leans."""
    angle, heading = np.radians([degrees, towards])
    return se3.exp([0.0, 0.0, 0.0, angle * np.cos(heading), angle * np.sin(heading), 0.0])


def seen(points: np.ndarray, T_odom_sensor: np.ndarray) -> Submap:
    """A posted cloud, which the sensor has turned with itself."""
    return Submap.from_cloud(Scan.validated(points.astype(np.float32), T_odom_sensor, 0))


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


@pytest.mark.parametrize("degrees", [11.0, 17.0, 30.0])
@pytest.mark.parametrize("scene_scale", [1.0, 0.25])
def test_where_ground_and_walls_contradict_the_odometry_a_submap_is_levelled_by_them(degrees, scene_scale):
    T_sensor_level = se3.exp([0, 0, 0, 0.05, -0.1, 0.0])
    points = se3.apply(T_sensor_level, np.concatenate([GROUND, WALLS]))
    submap = seen(points, leaning(degrees) @ se3.inverse(T_sensor_level))
    level, frame = submap.in_level_frame(scene_scale)
    assert level.leans
    up = se3.inverse(T_sensor_level)[2, :3]
    assert np.degrees(np.arccos(frame.rotation[:, 2] @ up)) < 0.5
    assert np.abs(frame.points_to_submap(level.points) - submap.points).max() < 1e-4
    moved = se3.apply(level.T_odom_submap, level.points * scene_scale) - se3.apply(submap.T_odom_submap, submap.points)
    assert np.abs(moved).max() < 1e-4
    again, same = submap.levelled().in_level_frame(scene_scale)
    assert np.array_equal(again.points, level.points) and np.array_equal(same.similarity, frame.similarity)


ROOFS = np.concatenate([
    se3.apply(se3.from_yaw(0.0, (x, y, 2.0)) @ leaning(25.0, 0.0), square(2, 0.0, 2.5, 3000))
    for x in (-18.0, -12.0, -6.0, 6.0, 12.0, 18.0) for y in (-18.0, -9.0, 9.0, 18.0)
])  # fmt: skip
"""Panels in rows, all tilted to one side."""


def slope(percent: float) -> np.ndarray:
    """Ground that climbs along x, and walls that stand upright on it."""
    points = np.concatenate([GROUND, WALLS])
    points[:, 2] += percent / 100.0 * points[:, 0]
    return points


def hillside(degrees: float, way_m: float = 4.0) -> np.ndarray:
    """A level way across a hillside, which rises to one side and falls to the other."""
    rng, tangent = np.random.default_rng(5), np.tan(np.radians(degrees))
    across = rng.uniform(-15.0, 15.0, 120_000)
    nearness = (4.0 / (4.0 + np.abs(across))) ** 2
    across = across[rng.random(len(across)) < nearness]
    points = np.stack([across, rng.uniform(-15.0, 15.0, len(across)), np.full(len(across), -1.7)], axis=1)
    points[:, 2] += tangent * np.sign(across) * np.maximum(np.abs(across) - 0.5 * way_m, 0.0)
    return points + rng.normal(0.0, 0.01, points.shape)


TREES = np.concatenate([
    np.stack([x + 0.4 * np.cos(turn), y + 0.4 * np.sin(turn), rng.uniform(-3.0, 6.0, 2500)], axis=1)
    for x in (-9.0, -3.0, 5.0, 11.0) for y in (-12.0, -5.0, 4.0, 9.0)
    for rng in [np.random.default_rng([9, int(x + 20), int(y + 20)])] for turn in [rng.uniform(0.0, 2.0 * np.pi, 2500)]
])  # fmt: skip
"""Trunks, upright."""

LEVEL = {
    "a level street": np.concatenate([GROUND, WALLS]),
    "a lean of 8 degrees": se3.apply(leaning(8.0), np.concatenate([GROUND, WALLS])),
    "a ramp of 10 %": slope(10.0),
    "a ramp of 15 %": slope(15.0),
    "a hill that climbs by 25 %, with trees": np.concatenate([slope(25.0)[: len(GROUND)], TREES]),
    "a steep ramp between walls": slope(30.0),
    "a path across a hillside of 12 degrees": hillside(12.0, 3.0),
    "a path across a hillside of 30 degrees": hillside(30.0, 3.0),
    "tilted panels over a level ground": np.concatenate([GROUND[::5], ROOFS]),
    "bushes": np.random.default_rng(3).uniform(-8, 8, (8000, 3)),
}


@pytest.mark.parametrize("name", LEVEL)
def test_a_submap_whose_surfaces_bear_the_odometry_out_or_tell_nothing_keeps_every_bit(name):
    submap = seen(LEVEL[name], se3.from_yaw(0.3, (1, 2, 3)) @ se3.exp([0, 0, 0, 1e-3, -2e-3, 0]))
    level, frame = submap.in_level_frame(1.0)
    assert not level.leans
    assert np.array_equal(level.points, submap.levelled().points)
    assert np.array_equal(frame.rotation, submap.levelled().T_scan_submap[:3, :3])


def test_a_view_of_a_robot_that_moves_is_levelled_alike():
    view = ViewWindow(SubmapConfig()).add(np.concatenate([GROUND, WALLS]), leaning(17.0))
    level, frame = view.submap.in_level_frame(1.0)
    assert level.leans
    assert np.degrees(np.arccos(frame.rotation[2, 2])) < 0.5
