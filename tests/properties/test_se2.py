"""Planar poses are rigid motions in space that keep heights."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from revisit.core.geometry import se3
from revisit.core.geometry.se2 import PlanarPose, angle_between, least_squares_pose

metres = st.floats(-100, 100)
yaws = st.floats(-3.1, 3.1)
poses = st.builds(lambda yaw, x, y: PlanarPose(yaw, np.array([x, y])), yaws, metres, metres)
seeds = st.integers(0, 2**32 - 1)


@given(poses, metres, seeds)
def test_a_planar_pose_moves_points_as_its_lifted_form_does(pose, height, seed):
    points = np.random.default_rng(seed).uniform(-50, 50, (10, 3))
    lifted = se3.apply(pose.lifted(height), points)
    np.testing.assert_allclose(lifted[:, :2], pose.apply(points[:, :2]), atol=1e-10)
    np.testing.assert_allclose(lifted[:, 2], points[:, 2] + height, atol=1e-10)


@given(poses, seeds)
def test_least_squares_recover_the_pose_that_moved_the_points(pose, seed):
    source = np.random.default_rng(seed).uniform(-50, 50, (5, 2))
    found = least_squares_pose(source, pose.apply(source))
    assert angle_between(np.array([found.yaw]), pose.yaw)[0] < 1e-9
    np.testing.assert_allclose(found.translation, pose.translation, atol=1e-8)


@given(poses, seeds)
def test_no_small_change_of_a_least_squares_pose_lowers_its_error(pose, seed):
    rng = np.random.default_rng(seed)
    source = rng.uniform(-50, 50, (8, 2))
    target = pose.apply(source) + rng.normal(0.0, 0.5, (8, 2))
    found = least_squares_pose(source, target)

    def error(yaw: float, x: float, y: float) -> float:
        changed = PlanarPose(found.yaw + yaw, found.translation + [x, y])
        return float(((changed.apply(source) - target) ** 2).sum())

    for step in np.vstack([np.eye(3), -np.eye(3)]) * 1e-3:
        assert error(*step) >= error(0.0, 0.0, 0.0) - 1e-9


@given(yaws, yaws, st.integers(-3, 3))
def test_whole_turns_between_angles_do_not_count(one, other, turns):
    between = angle_between(np.array([one + 2 * np.pi * turns]), other)[0]
    assert between == pytest.approx(float(np.arccos(np.clip(np.cos(one - other), -1, 1))), abs=1e-6)
