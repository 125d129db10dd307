"""The same scans are chosen of a stream that has them all and of one that leaves the others out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from revisit.core.config import SubmapConfig
from revisit.core.geometry import se3
from revisit.core.scan_marks import ScanMarks, marked_rows, way_along

MARKS = ScanMarks.of(SubmapConfig())


def drive(step: float, scans: int, jitter_m: float = 0.0, turn_deg: float = 0.0, seed: int = 0) -> list[np.ndarray]:
    """Poses of a drive along x that turns a little with each scan; each is off by up to `jitter_m` on each axis."""
    rng = np.random.default_rng(seed)
    at = np.column_stack([np.arange(scans) * step, np.zeros((scans, 2))]) + rng.uniform(-jitter_m, jitter_m, (scans, 3))
    return [se3.from_yaw(math.radians(turn_deg) * row, where) for row, where in enumerate(at)]


def ways_m(poses: list[np.ndarray]) -> list[float]:
    """The way up to each pose, metres."""
    ways, way = list[float](), None
    for pose in poses:
        way = MARKS.way_to(pose, way)
        ways.append(way.travelled_m)
    return ways


def chosen_with_way(poses: list[np.ndarray], travelled_m: list[float], returns: list[int]) -> list[int]:
    """The rows that are chosen where the way is told with each scan."""
    rows, last = list[int](), None
    for row, (pose, way_m, count) in enumerate(zip(poses, travelled_m, returns, strict=True)):
        if (chosen := MARKS.choose(last, way_m, pose, count)) is not None:
            rows.append(row)
            last = chosen
    return rows


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.02, 2.5), st.floats(0.0, 0.05), st.floats(0.0, 20.0), st.integers(0, 9),
    st.sampled_from([3_000, 21_000, 45_000, 59_990, 118_000]),
)  # fmt: skip
def test_a_thinned_stream_is_chosen_as_the_full_one(step, jitter_m, turn_deg, seed, returns):
    poses = drive(step, 150, jitter_m, turn_deg, seed)
    counts = (returns + np.random.default_rng(seed).integers(-30, 30, len(poses))).tolist()
    way_m = ways_m(poses)
    rows = chosen_with_way(poses, way_m, counts)
    assert rows == marked_rows(zip(poses, counts, strict=True), MARKS)
    thinned = [[of[row] for row in rows] for of in (poses, way_m, counts)]
    assert chosen_with_way(*thinned) == list(range(len(rows)))


@pytest.mark.parametrize(
    ("returns", "spacing_m"),
    [(118_000, 2.0), (60_000, 2.0), (59_000, 1.0), (29_000, 0.5), (5_000, 10 / 80), (0, 10 / 640)],
)
def test_marks_are_as_near_as_the_returns_of_a_scan_need(returns, spacing_m):
    assert MARKS.spacing_m(returns) == pytest.approx(spacing_m)
    assert returns == 0 or returns * MARKS.tau_m / MARKS.spacing_m(returns) >= MARKS.enough_returns


@pytest.mark.parametrize("step", [0.15, 0.5, 1.0, 1.99, 2.0, 2.01])
def test_scans_are_two_metres_apart_whatever_the_speed(step):
    rows = marked_rows(((pose, 118_000) for pose in drive(step, round(80 / step))), MARKS)
    gaps = np.diff(rows) * step
    assert rows[0] == 0 and np.abs(gaps[1:] - 2.0).max() <= step / 2 + 0.12
    assert gaps[0] <= 2.05


def test_a_turn_on_the_spot_is_seen_all_round_once():
    poses = [se3.from_yaw(math.radians(7.0) * row) for row in range(500)]
    rows = marked_rows(((pose, 118_000) for pose in poses), MARKS)
    assert len(rows) == 10 and rows[:3] == [0, 5, 10]


def test_a_robot_that_stands_still_gives_one_scan():
    assert marked_rows(((np.eye(4), 3_000) for _ in range(400)), MARKS) == [0]


def test_a_robot_that_trembles_where_it_stands_travels_nowhere():
    """An hour of ten scans a second, each off by a centimetre on each axis."""
    at = np.random.default_rng(3).normal(0.0, 0.01, (36_000, 3))
    poses = [se3.from_yaw(0.0, where) for where in at]
    assert way_along(poses, MARKS).travelled_m == 0.0
    assert marked_rows(((pose, 118_000) for pose in poses), MARKS) == [0]


@pytest.mark.parametrize("step", [0.003, 0.04, 0.15, 2.0])
def test_the_way_is_as_long_as_the_drive_whatever_the_speed(step):
    poses = drive(step, round(40 / step))
    assert way_along(poses, MARKS).travelled_m == pytest.approx((len(poses) - 1) * step, abs=MARKS.least_step_m)


@pytest.mark.parametrize("tau", [0.5, 10.0, 200.0, 1000.0])
def test_the_rounds_in_a_hall_are_a_way_however_long_a_submap_is(tau):
    """Ten rounds of 2 m around the middle: 126 m."""
    marks = ScanMarks.of(SubmapConfig(tau=tau, stride=tau / 2))
    around = [(2.0 * math.cos(angle), 2.0 * math.sin(angle), 0.0) for angle in np.arange(0.0, 20.0 * math.pi, 0.05)]
    way = way_along((se3.from_yaw(0.0, where) for where in around), marks)
    assert way.travelled_m == pytest.approx(20.0 * math.pi * 2.0, rel=0.02)


def test_a_jump_of_the_odometry_is_a_new_mark():
    poses = [se3.from_yaw(0.0, (x, 0, 0)) for x in (0.0, 9e7, 9e7 + 0.1)]
    assert marked_rows(((pose, 118_000) for pose in poses), MARKS) == [0, 1]


def test_a_scan_that_was_not_taken_leaves_its_mark_to_the_next():
    first = MARKS.choose(None, 0.0, np.eye(4), 118_000)
    assert first is not None
    assert MARKS.choose(first, 1.2, np.eye(4), 118_000) is not None
    later = MARKS.choose(first, 1.3, np.eye(4), 118_000)
    assert later is not None and later.travelled_m == 1.3
