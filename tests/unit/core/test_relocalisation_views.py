"""Views of a robot that moves: scans joined by odometry; and the drive that tells its possible poses apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.config import SubmapConfig
from revisit.core.errors import EmptyCloud
from revisit.core.geometry import se3
from revisit.core.relocalisation.telling_apart import Surroundings, tells_apart
from revisit.core.relocalisation.view_window import ViewWindow

CONFIG = SubmapConfig()
WALL = np.column_stack([np.full(400, 20.0), np.linspace(-10, 10, 400), np.linspace(0, 3, 400)]).astype(np.float32)


def at(x_m, yaw=0.0):
    return se3.from_yaw(yaw, (x_m, 0.0, 0.0))


def seen_from(T_odom_sensor):
    """The wall, which stands still, as a sensor sees it."""
    return se3.apply(se3.inverse(T_odom_sensor), WALL).astype(np.float32)


def test_scans_are_joined_in_the_frame_of_the_newest():
    window = ViewWindow(CONFIG)
    poses = [at(0.0), at(2.0, 0.3), at(4.0, -0.2)]
    for pose in poses:
        view = window.add(seen_from(pose), pose)
    assert view.ends == (400, 800, 1200) and window.travelled_m == pytest.approx(4.0)
    np.testing.assert_allclose(se3.apply(view.T_odom_view, view.points), np.tile(WALL, (3, 1)), atol=1e-4)
    submap = view.submap
    np.testing.assert_allclose(se3.apply(poses[-1], submap.origins), [pose[:3, 3] for pose in poses], atol=1e-5)
    assert submap.scan_index.tolist() == [0] * 400 + [1] * 400 + [2] * 400


def test_of_scans_between_two_marks_of_travel_the_newest_counts_and_old_ones_are_left_behind():
    window = ViewWindow(CONFIG)
    for step in range(251):
        view = window.add(seen_from(at(0.1 * step)), at(0.1 * step))
    assert window.travelled_m == pytest.approx(25.0)
    # One scan a metre along the last 10 m, and the newest.
    assert 10 <= len(view.ends) <= 12
    assert view.origins[0, 0] >= -CONFIG.tau - 1e-3


def test_standing_still_keeps_one_scan():
    window = ViewWindow(CONFIG)
    for _ in range(20):
        view = window.add(seen_from(at(0.0)), at(0.0))
    assert len(view.ends) <= 2 and window.travelled_m == 0.0


def test_a_view_is_bounded_however_dense_the_scans_are():
    config = replace(CONFIG, enough_returns=3_000)
    window, dense = ViewWindow(config), np.tile(WALL, (10, 1))
    for step in range(15):
        view = window.add(dense, at(float(step)))
    assert len(view.points) <= 2 * config.enough_returns
    assert np.diff(view.ends)[-1] == config.enough_returns


def test_a_scan_beyond_the_range_of_the_sensor_is_refused_and_the_window_stays():
    window = ViewWindow(CONFIG)
    window.add(WALL, at(0.0))
    with pytest.raises(EmptyCloud, match="metres"):
        window.add(WALL + np.float32([500.0, 0.0, 0.0]), at(1.0))
    assert window.travelled_m == 0.0
    assert len(window.add(WALL, at(2.0)).ends) == 2


def surroundings(x_m, unlike_at):
    """Places every 2 m along an aisle; those from `unlike_at` metres ahead on have a descriptor of their own."""
    ahead = np.arange(-20.0, 21.0, 2.0)
    descriptors = np.tile(np.float32([1.0, 0.0, 0.0]), (len(ahead), 1))
    descriptors[ahead >= unlike_at] = np.float32([0.0, 1.0, 0.0])
    positions = np.column_stack([x_m + ahead, np.zeros(len(ahead)), np.zeros(len(ahead))])
    return Surroundings(at(x_m), 0.45, positions, descriptors)


def test_the_drive_that_tells_poses_apart_is_the_shortest_to_where_they_differ():
    drive = tells_apart([surroundings(0.0, 12.0), surroundings(100.0, 40.0)], 1.0)
    assert (drive.direction_rad, drive.distance_m) == (0.0, 14.0)
    assert drive.difference == pytest.approx(1.0)


def test_where_all_looks_alike_or_nothing_is_stored_no_drive_is_told():
    assert tells_apart([surroundings(0.0, 40.0), surroundings(100.0, 40.0)], 1.0) is None
    nowhere = Surroundings(at(0.0), 0.5, np.zeros((0, 3)), np.zeros((0,), np.float32))
    assert tells_apart([surroundings(0.0, 4.0), nowhere], 1.0) is None
    assert tells_apart([], 1.0) is None
