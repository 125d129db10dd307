"""Deskewing: a sweep that was taken while the sensor moved, as if it had been taken at once."""

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.geometry.deskew import SweepMotion, deskewed, knots

SWEEP_NS = 100_000_000
TWIST = np.array([8.0, 0.5, 0.1, 0.05, 0.0, 1.5])


def pose(offset_ns: float) -> np.ndarray:
    """T_scan_sensor on a screw motion of 8 m/s and 1.5 rad/s."""
    return se3.exp(TWIST * offset_ns / 1e9)


def motion(offsets_ns: np.ndarray) -> SweepMotion:
    times = knots(offsets_ns)
    return SweepMotion(times, np.stack([pose(time) for time in times]))


@pytest.mark.parametrize("first_ns", [0, -SWEEP_NS, -SWEEP_NS // 2])
def test_points_lie_where_they_were_at_the_stamp(first_ns):
    rng = np.random.default_rng(1)
    world = rng.uniform(-50, 50, (2000, 3))
    offsets = rng.integers(first_ns, first_ns + SWEEP_NS, len(world))
    seen = np.array(
        [se3.apply(se3.inverse(pose(at)), point[None])[0] for at, point in zip(offsets, world, strict=True)]
    )
    assert np.abs(seen - world).max() > 1.0
    assert np.abs(deskewed(seen, offsets, motion(offsets)) - world).max() < 2e-3


def test_a_sensor_that_stands_still_changes_nothing():
    points, offsets = np.random.default_rng(2).uniform(-9, 9, (100, 3)), np.arange(100) * 1_000_000
    still = SweepMotion(knots(offsets), np.stack([np.eye(4)] * len(knots(offsets))))
    assert np.allclose(deskewed(points, offsets, still), points)


def test_points_that_did_not_come_back_stay_so():
    points, offsets = np.full((4, 3), np.nan), np.arange(4) * 10_000_000
    assert np.isnan(deskewed(points, offsets, motion(offsets))).all()
