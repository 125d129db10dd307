"""Which clouds are accepted as scans (rows G03-G14 of the bad-input table)."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.errors import BadField, BadTransform, DegenerateCloud, EmptyCloud, NonFinitePoints, OutOfRange
from revisit.core.scan import Scan, validate_cloud


def room(count: int) -> np.ndarray:
    return np.random.default_rng(4).uniform([-20, -20, -2], [20, 20, 6], (count, 3)).astype("f4")


@pytest.mark.parametrize("count", [0, 1, 99])  # G02, G03, G04
def test_fewer_than_100_points_are_empty(count):
    with pytest.raises(EmptyCloud):
        validate_cloud(room(count))


def test_100_points_are_enough_and_stay_as_they_are():  # G05
    cloud, report = validate_cloud(room(100))
    np.testing.assert_array_equal(cloud, room(100))
    assert cloud.flags.c_contiguous and cloud.dtype == np.float32
    assert (report.dropped_nonfinite, report.degenerate_plane) == (0, False)


def test_one_point_ten_thousand_times_is_degenerate():  # G06
    with pytest.raises(DegenerateCloud):
        validate_cloud(np.full((10_000, 3), 7.3, "f4"))


@pytest.mark.parametrize("direction", [[1, 0, 0], [0.3, -0.5, 0.8], [1, 1, 1]])
@pytest.mark.parametrize("offset", [0.0, 5000.0])
def test_a_line_is_degenerate(direction, offset):  # G07
    line = np.linspace(-50, 50, 10_000)[:, None] * np.array(direction) + offset
    with pytest.raises(DegenerateCloud):
        validate_cloud(line.astype("f4"))


@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_a_floor_is_accepted_and_flagged(tilt):  # G08
    floor = room(10_000)
    floor[:, 2] = tilt * floor[:, 0] - 1.7
    assert validate_cloud(floor)[1].degenerate_plane


def test_returns_that_did_not_come_are_dropped_and_counted():  # G09
    cloud = room(1000)
    cloud[::20, 1] = np.nan
    kept, report = validate_cloud(cloud)
    assert (len(kept), report.dropped_nonfinite) == (950, 50)
    np.testing.assert_array_equal(kept[0], room(1000)[1])


def test_a_cloud_of_nan_is_refused():  # G10
    cloud = room(10_000)
    cloud[:9_500] = np.nan
    with pytest.raises(NonFinitePoints):
        validate_cloud(cloud)


def test_ninety_percent_may_be_missing_and_not_one_more():
    cloud = room(2000)
    cloud[:1800] = np.nan
    assert len(validate_cloud(cloud)[0]) == 200
    cloud[1800] = np.nan
    with pytest.raises(NonFinitePoints):
        validate_cloud(cloud)


def test_what_remains_must_still_be_100_points():
    cloud = room(150)
    cloud[:51] = np.nan
    with pytest.raises(EmptyCloud):
        validate_cloud(cloud)


def test_one_infinite_coordinate_is_dropped():  # G11
    cloud = room(200)
    cloud[5, 0] = np.inf
    assert validate_cloud(cloud)[1].dropped_nonfinite == 1


@pytest.mark.parametrize("value", [1e30, np.finfo("f4").max, -1e5, 10_001])  # G12, G13
def test_coordinates_beyond_ten_kilometres_are_out_of_range(value):
    cloud = room(200)
    cloud[7, 2] = value
    with pytest.raises(OutOfRange, match="re-base the origin"):
        validate_cloud(cloud)


def test_ten_kilometres_are_in_range():
    cloud = room(200)
    cloud[7, 0] = -10_000
    assert len(validate_cloud(cloud)[0]) == 200


def test_denormal_and_negative_zero_coordinates_are_numbers():  # G14
    cloud = room(200)
    cloud[0] = [1e-42, -0.0, 0.0]
    assert validate_cloud(cloud)[1].dropped_nonfinite == 0


@pytest.mark.parametrize("shape", [(300,), (100, 2), (100, 4), (10, 10, 3)])
def test_points_have_three_coordinates(shape):
    with pytest.raises(BadField, match="points must be"):
        validate_cloud(np.zeros(shape, "f4"))


@pytest.mark.parametrize("stamp_ns", [-1, 2**63])
def test_a_time_stamp_is_a_non_negative_int64(stamp_ns):
    with pytest.raises(BadField, match="time stamp"):
        Scan.validated(room(200), np.eye(4), stamp_ns)


def test_a_scan_needs_a_rigid_pose():
    with pytest.raises(BadTransform):
        Scan.validated(room(200), np.diag([1.0, 1.0, -1.0, 1.0]), 0)


def test_the_points_of_a_scan_do_not_change_when_the_sender_reuses_its_buffer():
    buffer = room(200)
    scan = Scan.validated(buffer, np.eye(4), 2**63 - 1)
    buffer[:] = 0
    np.testing.assert_array_equal(scan.points, room(200))
