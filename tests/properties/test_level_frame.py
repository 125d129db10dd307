"""A level frame and its submap agree about points, directions, poses and covariances, at every scale."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from revisit.core.errors import BadTransform
from revisit.core.geometry import se3
from revisit.core.geometry.level_frame import LevelFrame, motion_between_levels, motion_between_submaps

metres = st.floats(-100, 100)
angles = st.floats(-1.8, 1.8)
scales = st.floats(0.01, 10.0)
motions = st.tuples(metres, metres, metres, angles, angles, angles).map(lambda xi: se3.exp(np.array(xi)))
frames = st.builds(LevelFrame.from_upright, motions, scales)
seeds = st.integers(0, 2**32 - 1)


def cloud(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-50, 50, (20, 3))


def covariance_of(seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(6, 6))
    return root @ root.T


@given(frames, seeds)
def test_points_directions_and_poses_return_from_the_level_frame(frame, seed):
    points, normals = cloud(seed), cloud(seed + 1) / 50.0
    np.testing.assert_allclose(frame.points_to_level(frame.points_to_submap(points)), points, atol=1e-7)
    np.testing.assert_allclose(frame.normals_to_submap(normals) @ frame.rotation, normals, atol=1e-12)
    T_submap_body = se3.exp(np.random.default_rng(seed).uniform(-1, 1, 6))
    np.testing.assert_allclose(frame.pose_to_submap(frame.pose_to_level(T_submap_body)), T_submap_body, atol=1e-7)


@given(frames, seeds)
def test_lengths_of_the_submap_are_divided_by_the_scale_and_directions_keep_theirs(frame, seed):
    points = cloud(seed)
    lengths, in_level = np.linalg.norm(np.diff(points, axis=0), axis=1), np.diff(frame.points_to_level(points), axis=0)
    np.testing.assert_allclose(np.linalg.norm(in_level, axis=1) * frame.scale, lengths, rtol=1e-6)
    np.testing.assert_allclose(
        np.linalg.norm(frame.normals_to_submap(points), axis=1), np.linalg.norm(points, axis=1), rtol=1e-9
    )


@given(frames, seeds)
def test_points_go_the_way_of_the_stored_similarity(frame, seed):
    points = cloud(seed)
    homogeneous = np.c_[points, np.ones(len(points))]
    np.testing.assert_allclose(frame.points_to_submap(points), (homogeneous @ frame.similarity.T)[:, :3], atol=1e-9)
    np.testing.assert_allclose(
        frame.points_to_level(points), (homogeneous @ np.linalg.inv(frame.similarity).T)[:, :3], rtol=1e-6, atol=1e-6
    )


@given(frames)
def test_a_frame_survives_its_stored_similarity(frame):
    restored = LevelFrame.from_similarity(frame.similarity)
    np.testing.assert_allclose(restored.rotation, frame.rotation, atol=1e-12)
    np.testing.assert_allclose(restored.translation, frame.translation, rtol=1e-12)
    assert restored.scale == pytest.approx(frame.scale, rel=1e-12)


@given(motions, motions, motions, scales)
def test_motions_between_submaps_are_those_of_similarities_multiplied_out(motion, of_query, of_match, scale):
    query, match = LevelFrame.from_upright(of_query, scale), LevelFrame.from_upright(of_match, scale)
    T_match_query = motion_between_submaps(motion, query, match)
    multiplied = match.similarity @ motion @ np.linalg.inv(query.similarity)
    np.testing.assert_allclose(T_match_query, multiplied, rtol=1e-6, atol=1e-6)
    assert np.linalg.det(T_match_query[:3, :3]) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(motion_between_levels(T_match_query, query, match), motion, rtol=1e-7, atol=1e-5)


@given(motions, motions, scales, seeds)
def test_a_point_seen_in_both_submaps_is_one_point_in_the_level_frames(of_query, of_match, scale, seed):
    query, match = LevelFrame.from_upright(of_query, scale), LevelFrame.from_upright(of_match, scale)
    T_level_match_query = se3.exp(np.random.default_rng(seed).uniform(-1, 1, 6))
    points = cloud(seed)
    by_submaps = se3.apply(motion_between_submaps(T_level_match_query, query, match), query.points_to_submap(points))
    by_levels = match.points_to_submap(se3.apply(T_level_match_query, points))
    np.testing.assert_allclose(by_submaps, by_levels, atol=1e-6)


@given(frames, seeds)
def test_a_covariance_is_turned_by_the_adjoint_of_the_upright_axes_with_lengths_scaled(frame, seed):
    covariance = covariance_of(seed)
    stretch = np.diag([*[frame.scale] * 3, 1.0, 1.0, 1.0])
    adjoint = se3.adjoint(se3.from_rotation_translation(frame.rotation, frame.translation)) @ stretch
    np.testing.assert_allclose(frame.covariance_to_submap(covariance), adjoint @ covariance @ adjoint.T, rtol=1e-12)


def test_a_small_motion_in_the_level_frame_is_its_covariances_motion_in_the_submap_frame():
    # A tangent of the level frame and its image must move the same pose: with one direction, the covariance is xi xi^T.
    frame = LevelFrame.from_upright(se3.exp([3.0, -2.0, 1.0, 0.3, 0.2, -0.4]), 0.25)
    tangent = 1e-5 * np.array([1.0, -2.0, 0.5, 0.3, 0.7, -0.2])
    T_match_query = se3.exp([2.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    before, after = (frame.pose_to_submap(pose) for pose in (T_match_query, se3.exp(tangent) @ T_match_query))
    moved = se3.log(after @ se3.inverse(before))
    np.testing.assert_allclose(
        np.outer(moved, moved), frame.covariance_to_submap(np.outer(tangent, tangent)), rtol=1e-4
    )


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf])
def test_a_scale_that_is_not_positive_and_finite_is_refused(scale):
    with pytest.raises(BadTransform, match="scale"):
        LevelFrame(scale=scale)


NO_SIMILARITIES = {
    "shape": np.eye(3),
    "zero": np.zeros((4, 4)),
    "mirrored": np.diag([1.0, 1.0, -1.0, 1.0]),
    "NaN": np.full((4, 4), np.nan),
    "stretched": np.diag([1.0, 2.0, 1.0, 1.0]),
    "immense": np.diag([1e200, 1e200, 1e200, 1.0]),
    "minute": np.diag([1e-200, 1e-200, 1e-200, 1.0]),
}


@pytest.mark.parametrize("matrix", NO_SIMILARITIES.values(), ids=NO_SIMILARITIES)
def test_what_is_no_similarity_is_refused(matrix):
    with pytest.raises(BadTransform):
        LevelFrame.from_similarity(matrix)
