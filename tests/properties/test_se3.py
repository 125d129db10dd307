"""Rigid motions form a group, and exp and log are each other's inverse."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from revisit.core.errors import BadTransform
from revisit.core.geometry import se3

metres = st.floats(-1000, 1000)
angles = st.floats(-1.8, 1.8)  # |phi| <= 3.12 < pi: the logarithm is unique
tangents = st.tuples(metres, metres, metres, angles, angles, angles).map(np.array)
motions = tangents.map(se3.exp)
points = st.tuples(metres, metres, metres).map(lambda p: np.array([p]))


@given(motions, motions, motions)
def test_composition_is_associative_and_closed(a, b, c):
    np.testing.assert_allclose((a @ b) @ c, a @ (b @ c), atol=1e-8)
    product = a @ b
    np.testing.assert_allclose(product[:3, :3] @ product[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(product[:3, :3]) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_array_equal(product[3], [0, 0, 0, 1])


@given(motions)
def test_the_inverse_undoes_a_motion_from_both_sides(motion):
    np.testing.assert_allclose(motion @ se3.inverse(motion), np.eye(4), atol=1e-9)
    np.testing.assert_allclose(se3.inverse(motion) @ motion, np.eye(4), atol=1e-9)


@given(motions, motions, points)
def test_applying_a_product_is_applying_both(a, b, point):
    np.testing.assert_allclose(se3.apply(a @ b, point), se3.apply(a, se3.apply(b, point)), atol=1e-8)


@given(motions, points, points)
def test_a_motion_keeps_distances(motion, p, q):
    before = np.linalg.norm(p - q)
    after = np.linalg.norm(se3.apply(motion, p) - se3.apply(motion, q))
    assert after == pytest.approx(before, abs=1e-8)


@given(tangents)
def test_log_undoes_exp_below_a_half_turn(tangent):
    if np.linalg.norm(tangent[3:]) < math.pi - 1e-3:
        np.testing.assert_allclose(se3.log(se3.exp(tangent)), tangent, atol=1e-6)


@given(motions)
def test_exp_undoes_log(motion):
    np.testing.assert_allclose(se3.exp(se3.log(motion)), motion, atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-8, 1e-7, 1e-6, 1e-4, 1e-3, 1.0, math.pi - 1e-9, math.pi])
def test_exp_and_log_agree_near_no_turn_and_near_a_half_turn(angle):
    tangent = np.array([3.0, -2.0, 5.0, angle * 0.6, 0.0, angle * 0.8])
    motion = se3.exp(tangent)
    assert se3.rotation_angle(motion) == pytest.approx(angle, abs=1e-9)
    np.testing.assert_allclose(se3.exp(se3.log(motion)), motion, atol=1e-9)


@pytest.mark.parametrize("angle", [1e-9, 1e-8, 1e-7, 1e-5])
def test_small_turns_move_the_translation_by_half_the_turn(angle):
    # First order: V = I + phi/2 x; about z a motion along x drifts to y by angle / 2.
    motion = se3.exp([1.0, 0.0, 0.0, 0.0, 0.0, angle])
    assert motion[1, 3] == pytest.approx(angle / 2, rel=1e-4)


def test_a_quarter_turn_on_a_circle_of_one_metre():
    # Along x at 1 m/rad while turning left: after pi/2 the robot is at (1, 1), heading +y.
    motion = se3.exp([math.pi / 2, 0, 0, 0, 0, math.pi / 2])
    np.testing.assert_allclose(motion[:3, 3], [1, 1, 0], atol=1e-12)
    assert se3.yaw(motion) == pytest.approx(math.pi / 2)


@given(motions)
def test_quaternions_carry_the_rotation(motion):
    quaternion = se3.to_quaternion(motion)
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-12)
    assert quaternion[3] >= 0
    np.testing.assert_allclose(se3.from_quaternion(quaternion, motion[:3, 3]), motion, atol=1e-9)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_half_turns_have_quaternions(axis):
    tangent = np.zeros(6)
    tangent[3 + axis] = math.pi
    quaternion = se3.to_quaternion(se3.exp(tangent))
    expected = np.zeros(4)
    expected[axis] = 1
    np.testing.assert_allclose(np.abs(quaternion), expected, atol=1e-9)


def test_a_quaternion_of_nearly_unit_norm_is_normalised():
    motion = se3.from_quaternion([0, 0, 0.7072, 0.7072], [1, 2, 3])  # norm 1.00013
    np.testing.assert_allclose(motion, se3.from_yaw(math.pi / 2, [1, 2, 3]), atol=1e-12)


@pytest.mark.parametrize(
    "quaternion",
    [[0, 0, 0, 0], [0, 0, 0, 1.0011], [0, 0, 0, 0.998], [np.nan, 0, 0, 1], [0, 0, np.inf, 0], [0, 0, 1], [1e308] * 4],
)
def test_other_quaternions_are_refused(quaternion):
    with pytest.raises(BadTransform):
        se3.from_quaternion(quaternion, [0, 0, 0])


def test_a_quaternion_needs_a_finite_translation():
    with pytest.raises(BadTransform, match="NaN or infinity"):
        se3.from_quaternion([0, 0, 0, 1], [0, np.nan, 0])


@given(motions)
def test_a_motion_is_valid_and_unchanged(motion):
    np.testing.assert_allclose(se3.validated(motion), motion, atol=1e-9)
    np.testing.assert_allclose(se3.validated(motion[:3]), motion, atol=1e-9)


BROKEN = {
    "a reflection": np.diag([1.0, 1.0, -1.0, 1.0]),
    "a scale": np.diag([1.01, 1.01, 1.01, 1.0]),
    "a shear": np.eye(4) + np.diag([0.1, 0, 0], k=1),
    "all zero": np.zeros((4, 4)),
    "a wrong last row": np.vstack([np.eye(4)[:3], [0, 0, 1, 1]]),
    "NaN": np.full((4, 4), np.nan),
    "infinity": np.where(np.eye(4) == 1, np.inf, 0),
    "a rotation of 1e300": np.diag([1e300, 1e300, 1e300, 1.0]),
    "a place beyond the Earth": se3.from_rotation_translation(np.eye(3), [2e8, 0, 0]),
    "a wrong shape": np.eye(3),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_not_a_rigid_motion_is_refused(name):
    with pytest.raises(BadTransform):
        se3.validated(BROKEN[name])


def test_a_rotation_printed_with_four_digits_is_made_orthonormal():
    rough = np.round(se3.exp([1, 2, 3, 0.3, -0.2, 0.9]), 4)
    rotation = se3.validated(rough)[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation, rough[:3, :3], atol=2e-4)
