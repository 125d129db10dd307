"""Keypoints that look alike, and the planar pose that most of them vote for."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from revisit.core.config import VerificationConfig
from revisit.core.geometry.se2 import PlanarPose, angle_between
from revisit.core.kernels.two_point_vote import SHORTEST_BASE, best_two_point_pose
from revisit.core.place import Place
from revisit.core.place.correspondences import Correspondences, correspond
from revisit.core.verification.keypoint_fit import fit_planar_pose, plain_refined

CONFIG = VerificationConfig()
TOLERANCE, YAW_TOLERANCE = CONFIG.keypoint_tolerance, np.radians(CONFIG.yaw_tolerance)


def keypoint_place(keypoints: np.ndarray, orientations: np.ndarray, descriptors: np.ndarray) -> Place:
    """A place of keypoints alone; the second half of a patch changes its sign under half a turn."""
    size = descriptors.shape[1]
    parity = np.where(np.arange(size) < size // 2, 1.0, -1.0)
    values = (np.asarray(value, np.float32) for value in (keypoints, orientations, descriptors, parity))
    nothing = np.zeros((0, 3), np.float32)
    return Place(*values, points=nothing, normals=nothing, standing_count=0, model="m")


def unit_rows(rng: np.random.Generator, count: int, size: int = 16) -> np.ndarray:
    rows = rng.normal(size=(count, size))
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def plain_two_point_pose(source, target, yaws, tolerance, yaw_tolerance):
    """The two-point vote in plain NumPy, one pose an iteration."""
    best, most = np.zeros(3), 0
    for i, j in itertools.combinations(range(len(source)), 2):
        (sx, sy), (tx, ty) = source[j] - source[i], target[j] - target[i]
        if np.hypot(sx, sy) < SHORTEST_BASE * tolerance or abs(np.hypot(sx, sy) - np.hypot(tx, ty)) > tolerance:
            continue
        yaw = np.arctan2(ty, tx) - np.arctan2(sy, sx)
        if (angle_between(yaws[[i, j]], yaw) > yaw_tolerance).any():
            continue
        middle = PlanarPose(yaw, np.zeros(2)).apply(source[[i, j]]).mean(axis=0)
        pose = PlanarPose(yaw, target[[i, j]].mean(axis=0) - middle)
        near = np.linalg.norm(pose.apply(source) - target, axis=1) <= tolerance
        votes = int((near & (angle_between(yaws, yaw) < yaw_tolerance)).sum())
        if votes > most:
            best, most = np.array([yaw, *pose.translation]), votes
    return best, most


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 25), st.floats(0.0, 1.0))
def test_the_compiled_vote_is_the_plain_one(seed, count, share_true):
    rng = np.random.default_rng(seed)
    true = PlanarPose(rng.uniform(-np.pi, np.pi), rng.uniform(-20, 20, 2))
    source = rng.uniform(-30, 30, (count, 2))
    agrees = rng.random(count) < share_true
    target = np.where(agrees[:, None], true.apply(source), rng.uniform(-30, 30, (count, 2)))
    target += rng.normal(0, 0.3, (count, 2))
    yaws = np.where(agrees, true.yaw, rng.uniform(-np.pi, np.pi, count)) + rng.normal(0, 0.1, count)
    found = best_two_point_pose(source, target, yaws, TOLERANCE, YAW_TOLERANCE)
    expected, votes = plain_two_point_pose(source, target, yaws, TOLERANCE, YAW_TOLERANCE)
    assert found[3] == votes
    np.testing.assert_allclose(np.cos(found[0] - expected[0]), 1.0, atol=1e-12)
    np.testing.assert_allclose(found[1:3], expected[1:], atol=1e-9)


@pytest.mark.parametrize(("seed", "true"), [(0, 60), (1, 12), (2, 2), (3, 0)])
def test_the_compiled_refinement_is_the_plain_one(seed, true):
    rng = np.random.default_rng(seed)
    pose, source = PlanarPose(3.1, np.array([4.0, -7.0])), rng.uniform(-40, 40, (80, 2))
    target = np.where(np.arange(80)[:, None] < true, pose.apply(source), rng.uniform(-300, 300, (80, 2)))
    target, yaws = target + rng.normal(0, 0.3, (80, 2)), pose.yaw + rng.normal(0, 0.3, 80)
    given = Correspondences(np.stack([np.arange(80), np.arange(80) // 2], axis=1), source, target, yaws)
    found = fit_planar_pose(given, CONFIG)
    best = best_two_point_pose(source, target, yaws, TOLERANCE, YAW_TOLERANCE)
    expected, agree = plain_refined(PlanarPose(best[0], best[1:3]), given, CONFIG)
    assert found.inliers == len(set((np.flatnonzero(agree) // 2).tolist()))
    np.testing.assert_allclose([found.pose.yaw, *found.pose.translation], [expected.yaw, *expected.translation])


def test_two_points_that_lie_too_near_propose_no_yaw():
    source = np.array([[0.0, 0.0], [0.99 * SHORTEST_BASE * TOLERANCE, 0.0]])
    assert not best_two_point_pose(source, source, np.zeros(2), TOLERANCE, YAW_TOLERANCE).any()
    assert best_two_point_pose(1.02 * source, 1.02 * source, np.zeros(2), TOLERANCE, YAW_TOLERANCE)[3] == 2


@pytest.mark.parametrize("yaw_deg", [0.0, 60.0, 179.0, -135.0])
def test_a_pose_is_found_among_three_times_as_many_false_correspondences(yaw_deg):
    rng = np.random.default_rng(1)
    true = PlanarPose(np.radians(yaw_deg), np.array([5.0, -8.0]))
    source = rng.uniform(-40, 40, (80, 2))
    target = np.r_[true.apply(source[:20]), rng.uniform(-40, 40, (60, 2))]
    yaws = np.r_[np.full(20, true.yaw), rng.uniform(-np.pi, np.pi, 60)]
    rows = np.stack([np.arange(80)] * 2, axis=1)
    fit = fit_planar_pose(Correspondences(rows, source, target, yaws), CONFIG)
    assert fit.inliers >= 20 and fit.correspondences == 80
    assert angle_between(np.array([fit.pose.yaw]), true.yaw)[0] < 0.01
    np.testing.assert_allclose(fit.pose.translation, true.translation, atol=0.3)


def test_correspondences_of_one_keypoint_count_once():
    source = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 0.4], [20.0, -0.4]])
    pairs = np.array([[0, 0], [1, 1], [1, 2], [1, 3]])
    one_sided = Correspondences(pairs, source[[0, 1, 1, 1]], source, np.zeros(4))
    assert fit_planar_pose(one_sided, CONFIG).inliers == 2


def test_without_correspondences_nothing_agrees():
    empty = keypoint_place(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 16)))
    some = keypoint_place(np.ones((3, 2)), np.zeros(3), unit_rows(np.random.default_rng(0), 3))
    for query, match in ((empty, some), (some, empty), (empty, empty)):
        correspondences = correspond(query, match, 10)
        assert len(correspondences) == 0
        assert fit_planar_pose(correspondences, CONFIG).inliers == 0


def test_each_keypoint_finds_the_one_that_looks_like_it_and_the_likest_come_first():
    rng = np.random.default_rng(2)
    patches, order = unit_rows(rng, 12), rng.permutation(12)
    noise = np.linspace(0.0, 0.2, 12)[:, None] * unit_rows(rng, 12)
    query = keypoint_place(rng.uniform(-9, 9, (12, 2)), np.zeros(12), patches)
    match = keypoint_place(rng.uniform(-9, 9, (12, 2)), np.full(12, 0.5), (patches + noise)[order])
    found = correspond(query, match, 5)
    assert all(order[column] == row for row, column in found.pairs)
    likeness = [float(query.descriptors[row] @ match.descriptors[column]) for row, column in found.pairs]
    assert len(found) == 5 and likeness == sorted(likeness, reverse=True)
    np.testing.assert_allclose(found.yaws, 0.5, atol=1e-6)
    np.testing.assert_array_equal(found.query_points, query.keypoints[found.pairs[:, 0]])
    np.testing.assert_array_equal(found.match_points, match.keypoints[found.pairs[:, 1]])


def test_a_patch_that_fits_upside_down_implies_half_a_turn_more():
    rng = np.random.default_rng(3)
    query = keypoint_place(rng.uniform(-9, 9, (6, 2)), np.zeros(6), unit_rows(rng, 6))
    turned = replace(query, descriptors=query.descriptors * query.parity)
    np.testing.assert_allclose(correspond(query, turned, 6).yaws, np.pi)
    np.testing.assert_allclose(correspond(query, query, 6).yaws, 0.0)
