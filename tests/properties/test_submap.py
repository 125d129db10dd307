"""How a stream of scans becomes submaps, whatever way the robot heads."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from revisit.core.config import SubmapConfig
from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.scan import Scan
from revisit.core.submap import Submap, SubmapBuilder, next_window_start

CONFIG = SubmapConfig(tau=10.0, stride=5.0, max_range=80.0, min_range=1.0)


def room(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform([-20, -20, -2], [20, 20, 6], (150, 3)).astype("f4")


def scan_at(pose: np.ndarray, stamp_ns: int = 0, seed: int = 0) -> Scan:
    return Scan.validated(room(seed), pose, stamp_ns)


def straight_drive(metres: int) -> list[Scan]:
    """One scan a metre along x; the stamp is the metre."""
    return [scan_at(se3.from_yaw(0.0, (float(m), 0, 0)), m, seed=m) for m in range(metres + 1)]


def windows(scans: list[Scan], config: SubmapConfig = CONFIG) -> list[tuple[int, int]]:
    """(first, last) stamp of each finished submap."""
    builder = SubmapBuilder(config)
    finished = [window for scan in scans if (window := builder.add(scan)) is not None]
    return [(window[0].stamp_ns, window[-1].stamp_ns) for window in finished]


def test_windows_are_ten_metres_and_start_every_five():
    assert windows(straight_drive(26)) == [(0, 10), (5, 15), (10, 20), (15, 25)]


def test_a_stride_of_the_window_leaves_no_overlap():
    assert windows(straight_drive(31), SubmapConfig(tau=10.0, stride=10.0)) == [(0, 10), (10, 20), (20, 30)]


def test_a_robot_that_stands_makes_no_submap_and_travel_counts_not_distance():
    assert windows([scan_at(np.eye(4), i) for i in range(50)]) == []
    shuttle = [scan_at(se3.from_yaw(0.0, (float(i % 2), 0, 0)), i) for i in range(11)]
    assert windows(shuttle) == [(0, 10)]


def test_flush_gives_the_rest_once_and_nothing_after_an_exact_end():
    builder = SubmapBuilder(CONFIG)
    for scan in straight_drive(12):
        builder.add(scan)
    rest = builder.flush()
    assert rest is not None and (rest[0].stamp_ns, rest[-1].stamp_ns) == (5, 12)
    builder = SubmapBuilder(CONFIG)
    for scan in straight_drive(10):
        builder.add(scan)
    assert builder.flush() is None
    assert SubmapBuilder(CONFIG).flush() is None


def test_a_jump_of_the_odometry_ends_the_window_at_once():
    far = [*straight_drive(3), scan_at(se3.from_yaw(0.0, (9e7, 0, 0)), 4)]
    started = time.monotonic()
    assert windows(far) == [(0, 4)]
    assert time.monotonic() - started < 1.0


@given(st.floats(0, 1e4), st.floats(0, 1e4), st.floats(0.5, 50), st.floats(0.5, 50))
def test_the_next_window_is_whole_strides_on_and_still_open(start, extra, tau, stride):
    config = SubmapConfig(tau=tau, stride=stride)
    travelled = start + tau + extra
    following = next_window_start(start, travelled, config)
    strides = (following - start) / stride
    assert strides == pytest.approx(round(strides), abs=1e-6) and strides >= 1 - 1e-9
    assert travelled - following < tau + 1e-6
    assert round(strides) == 1 or travelled - (following - stride) >= tau - 1e-6


@settings(max_examples=25)
@given(st.lists(st.floats(0.0, 4.0), min_size=1, max_size=60), st.floats(-3, 3), st.floats(-500, 500))
def test_windows_do_not_depend_on_where_the_robot_starts_or_heads(steps, heading, east):
    path = np.cumsum([0.0, *np.round(steps, 2)])
    here = [scan_at(se3.from_yaw(0.0, (x, 0, 0)), i) for i, x in enumerate(path)]
    T_there_here = se3.from_yaw(heading, (east, -east, 3.0))
    there = [Scan.validated(s.points, T_there_here @ s.T_odom_sensor, s.stamp_ns) for s in here]
    config = SubmapConfig(tau=10.0003, stride=5.0001)  # no sum of steps of 1 cm ends on a boundary
    assert windows(here, config) == windows(there, config)


@settings(max_examples=20)
@given(st.floats(-3.1, 3.1), st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))
def test_a_submap_does_not_depend_on_the_odometry_frame(heading, east, north):
    scans = straight_drive(10)
    T_other_odom = se3.from_yaw(heading, (east, north, 0.0))
    moved = [Scan.validated(s.points, T_other_odom @ s.T_odom_sensor, s.stamp_ns) for s in scans]
    first, second = Submap.from_scans(scans, CONFIG), Submap.from_scans(moved, CONFIG)
    np.testing.assert_allclose(second.points, first.points, atol=1e-4)
    np.testing.assert_allclose(second.origins, first.origins, atol=1e-4)
    expected = se3.apply(T_other_odom, first.position[None])[0]
    np.testing.assert_allclose(second.position, expected, atol=1e-6)


def test_a_submap_lies_in_the_frame_of_its_middle_scan():
    scans = straight_drive(10)
    submap = Submap.from_scans(scans, CONFIG)
    assert submap.scan_count == 11
    np.testing.assert_array_equal(submap.T_odom_submap, scans[5].T_odom_sensor)
    np.testing.assert_allclose(submap.origins[:, 0], np.arange(-5, 6), atol=1e-6)
    np.testing.assert_allclose(submap.position, [5, 0, 0])
    own = submap.points[submap.scan_index == 5]
    near = np.linalg.norm(scans[5].points, axis=1) >= CONFIG.min_range
    np.testing.assert_allclose(own, scans[5].points[near], atol=1e-6)


def test_each_point_knows_its_scan_in_order():
    submap = Submap.from_scans(straight_drive(10), CONFIG)
    assert (np.diff(submap.scan_index) >= 0).all()
    assert set(submap.scan_index) == set(range(11))
    assert len(submap.scan_index) == len(submap.points)


def test_the_order_of_points_within_scans_does_not_change_the_set_of_points():
    scans = straight_drive(4)
    mixed = [Scan.validated(s.points[::-1], s.T_odom_sensor, s.stamp_ns) for s in scans]
    straight, reversed_ = (Submap.from_scans(group, CONFIG).points for group in (scans, mixed))
    np.testing.assert_array_equal(np.unique(straight, axis=0), np.unique(reversed_, axis=0))


def test_returns_nearer_or_farther_than_the_range_are_left_out():
    points = room()
    points[:3] = [[0.5, 0, 0], [90, 0, 0], [50, 0, 0]]
    scan = Scan.validated(points, np.eye(4), 0)
    kept = Submap.from_scans([scan], CONFIG).points
    assert not (kept == points[0]).all(axis=1).any()
    assert not (kept == points[1]).all(axis=1).any()
    assert (kept == points[2]).all(axis=1).any()


def test_a_cloud_accumulated_elsewhere_keeps_every_point():
    points = room()
    points[0] = [90, 0, 0]
    pose = se3.from_yaw(0.3, (1, 2, 3))
    submap = Submap.from_cloud(Scan.validated(points, pose, 9))
    np.testing.assert_array_equal(submap.points, points)
    np.testing.assert_allclose(submap.position, [1, 2, 3])
    np.testing.assert_array_equal(submap.origins, np.zeros((1, 3)))


def test_scans_with_more_points_than_there_is_room_for_are_refused():
    scans = straight_drive(10)
    with pytest.raises(BadField, match="more than"):
        Submap.accumulated(iter(scans), np.eye(4), CONFIG, sum(len(scan.points) for scan in scans) - 1)


def test_scans_are_put_together_in_the_frame_that_is_asked_for():
    scans = straight_drive(10)
    elsewhere = se3.from_yaw(0.5, (3.0, 1.0, 0.0))
    room = sum(len(scan.points) for scan in scans)
    given, own = Submap.accumulated(iter(scans), elsewhere, CONFIG, room), Submap.from_scans(scans, CONFIG)
    np.testing.assert_allclose(given.T_odom_submap, elsewhere)
    in_odom = [se3.apply(one.T_odom_submap, one.origins) for one in (given, own)]
    np.testing.assert_allclose(in_odom[0], in_odom[1], atol=1e-5)
