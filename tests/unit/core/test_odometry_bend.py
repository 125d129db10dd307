"""Odometry that turns beside the truth within a submap is found, and its scans are laid on each other."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.config import SubmapConfig
from revisit.core.geometry import se3
from revisit.core.odometry_bend import odometry_bend
from revisit.core.scan import Scan
from revisit.core.scan_disagreement import scan_disagreement
from revisit.core.submap import Submap
from tests.unit.core.test_scan_disagreement import street


def bent(rate_deg: float, *, scans: int = 5, jitter_deg: float = 0.0) -> tuple[Submap, Submap]:
    """Scans over 8 m along x, whose odometry turns by `rate_deg` a metre, level; and the same with the true poses."""
    rng, given, true = np.random.default_rng(4), [], []
    step_m = 8.0 / (scans - 1)
    pose = se3.from_yaw(0.0, (-4.0, 0.0, 1.6))
    for number in range(scans):
        T_true = se3.from_yaw(0.0, (-4.0 + step_m * number, 0.0, 1.6))
        points = (street(rng) - T_true[:3, 3] + rng.normal(0.0, 0.01, (27_000, 3))).astype(np.float32)
        jitter = se3.from_yaw(np.radians(rng.normal(0.0, jitter_deg)))
        given.append(Scan.validated(points, pose @ jitter, number + 1))
        true.append(Scan.validated(points, T_true, number + 1))
        pose = pose @ se3.from_yaw(0.0, (step_m, 0.0, 0.0)) @ se3.from_yaw(np.radians(rate_deg * step_m))
    return tuple(Submap.from_scans(some, SubmapConfig()).levelled() for some in (given, true))  # type: ignore[return-value]


@pytest.mark.parametrize("rate_deg", [0.1, -0.3, 0.6])
def test_a_steady_turn_is_found_and_its_scans_come_to_lie_where_they_were_taken(rate_deg: float) -> None:
    submap, true = bent(rate_deg)
    found = odometry_bend(submap)
    assert found is not None
    assert np.degrees(found.turn[2]) == pytest.approx(rate_deg, abs=0.02)
    straight = found.straightened(submap)
    assert np.abs(straight.points - true.points).max() < 0.25 * np.abs(submap.points - true.points).max()
    assert (straight.T_odom_submap == submap.T_odom_submap).all()
    told = scan_disagreement(straight)
    assert told is not None and told.surface < 0.004


def test_the_middle_scan_and_the_given_submap_stay() -> None:
    submap, _ = bent(0.3)
    before = submap.points.copy()
    found = odometry_bend(submap)
    assert found is not None
    straight, middle = found.straightened(submap), submap.scan_index == 2
    assert (submap.points == before).all()
    np.testing.assert_array_equal(straight.points[middle], submap.points[middle])
    np.testing.assert_array_equal(straight.origins[2], submap.origins[2])


@pytest.mark.parametrize("jitter_deg", [0.0, 0.1])
def test_odometry_that_is_good_bends_nothing(jitter_deg: float) -> None:
    assert odometry_bend(bent(0.0, jitter_deg=jitter_deg)[0]) is None


def test_two_scans_tell_no_bend() -> None:
    assert odometry_bend(bent(0.3, scans=2)[0]) is None
