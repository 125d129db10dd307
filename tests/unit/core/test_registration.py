"""ICP: derivatives that agree with differences, known motions recovered, and poses that surfaces do not fix."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.kernels.patches import patches_of
from revisit.core.kernels.surface_contact import touching_rows
from revisit.core.verification.oriented_points import OrientedPoints, contact
from revisit.core.verification.registration import (
    MIN_COUNTERPARTS,
    Counterparts,
    find_counterparts,
    gauss_newton_step,
    information,
    iterate,
    observability,
    point_to_plane_jacobian,
    reconsider,
    register,
)
from tests.support.yards import yard

CONFIG = VerificationConfig()


def surface(seed: int = 1, count: int = 3000) -> OrientedPoints:
    """Points of a yard of walls on the ground."""
    made_up = yard(seed)
    rows = np.random.default_rng(seed).permutation(len(made_up.vertices))[:count]
    return OrientedPoints(made_up.vertices[rows].astype(float), made_up.normals[rows].astype(float), count)


def plane(normal: tuple[float, float, float], offset: float = 5.0) -> OrientedPoints:
    """A square of 40 m at `offset` along its normal, a point a metre."""
    axis = np.array(normal)
    one, other = np.eye(3)[np.abs(axis) < 0.5]
    a, b = (grid.ravel()[:, None] for grid in np.meshgrid(np.arange(-20.0, 21.0), np.arange(-20.0, 21.0)))
    points = a * one + b * other + offset * axis
    return OrientedPoints(points, np.tile(axis, (len(points), 1)), len(points))


def joined(*parts: OrientedPoints) -> OrientedPoints:
    """Several surfaces as one."""
    points = np.concatenate([part.points for part in parts])
    return OrientedPoints(points, np.concatenate([part.normals for part in parts]), len(points))


def random_pairs(seed: int, count: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, points on the planes and unit normals of these planes, each (count, 3)."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    points = rng.uniform(-20, 20, (count, 3))
    return points, points + rng.normal(0, 0.1, (count, 3)), normals / np.linalg.norm(normals, axis=1, keepdims=True)


@pytest.mark.parametrize("seed", range(3))
def test_the_jacobian_agrees_with_central_differences(seed):
    points, on_planes, normals = random_pairs(seed)

    def residuals(tangent: np.ndarray) -> np.ndarray:
        return ((se3.apply(se3.exp(tangent), points) - on_planes) * normals).sum(axis=1)

    step = 1e-6
    differences = [(residuals(step * axis) - residuals(-step * axis)) / (2 * step) for axis in np.eye(6)]
    np.testing.assert_allclose(point_to_plane_jacobian(points, normals), np.transpose(differences), atol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_a_step_leaves_no_slope_of_the_weighted_linear_error(seed):
    # The step minimises sum w (r + J x)^2 with the weights of the residuals before it.
    points, on_planes, normals = random_pairs(seed)
    residuals = ((points - on_planes) * normals).sum(axis=1)
    step = gauss_newton_step(Counterparts(points, residuals, normals), reach=1.0)
    weights = (1.0 + (residuals / 0.2) ** 2) ** -2
    jacobian = point_to_plane_jacobian(points, normals)

    def error(tangent: np.ndarray) -> float:
        return float((weights * (residuals + jacobian @ tangent) ** 2).sum())

    slopes = [(error(step + 1e-5 * axis) - error(step - 1e-5 * axis)) / 2e-5 for axis in np.eye(6)]
    curvature = np.trace((jacobian * weights[:, None]).T @ jacobian)
    np.testing.assert_allclose(slopes, 0.0, atol=2e-6 * curvature)


def test_one_step_on_exact_planes_recovers_a_small_motion_in_closed_form():
    # With the true planes as counterparts the error is linear to first order: one step is exact up to its square.
    points, _, normals = random_pairs(5)
    tangent = 1e-3 * np.array([1.0, -2.0, 0.5, 0.03, -0.02, 0.05])
    residuals = ((se3.apply(se3.exp(tangent), points) - points) * normals).sum(axis=1)
    step = gauss_newton_step(Counterparts(se3.apply(se3.exp(tangent), points), residuals, normals), reach=1.0)
    np.testing.assert_allclose(step, -tangent, atol=1e-5)


@pytest.mark.parametrize("tangent", [[0.3, -0.2, 0.1, 0.0, 0.0, 0.02], [-0.5, 0.4, 0.2, 0.01, -0.01, -0.03]])
def test_icp_recovers_a_known_motion_of_a_yard(tangent):
    T_match_query, match = se3.exp(tangent), surface()
    query = match.moved(se3.inverse(T_match_query))
    found = iterate(np.eye(4), query, match, CONFIG.coarse_distance, 30)
    error = se3.inverse(T_match_query) @ iterate(found, query, match, CONFIG.fine_distance, 10)
    assert np.linalg.norm(error[:3, 3]) < 1e-3
    assert se3.rotation_angle(error) < 1e-4


def test_icp_stays_where_both_surfaces_are_one():
    np.testing.assert_allclose(iterate(np.eye(4), surface(), surface(), 1.0, 5), np.eye(4), atol=1e-12)


def test_icp_gives_up_without_a_step_where_too_little_is_near():
    start, few = se3.from_yaw(0.1), surface(count=MIN_COUNTERPARTS - 1)
    np.testing.assert_array_equal(iterate(start, few, surface(), 100.0, 5), start)
    far = se3.from_yaw(0.0, (500.0, 0.0, 0.0))
    np.testing.assert_array_equal(iterate(far, surface(), surface(), 1.0, 5), far)


def test_counterparts_are_near_and_face_alike():
    wall = plane((1.0, 0.0, 0.0))
    behind = replace(wall, normals=-wall.normals)
    assert len(find_counterparts(wall.shifted(np.array([0.5, 0, 0])), wall, 1.0).points) == len(wall.points)
    assert len(find_counterparts(behind, wall, 1.0).points) == 0
    assert len(find_counterparts(wall.shifted(np.array([1.5, 0, 0])), wall, 1.0).points) == 0
    np.testing.assert_allclose(find_counterparts(wall.shifted(np.array([0.5, 0, 0])), wall, 1.0).residuals, 0.5)


def test_the_start_on_which_most_points_agree_is_refined():
    match = surface()
    wrong, right = se3.from_yaw(1.0, (20.0, 5.0, 0.0)), se3.from_yaw(0.02, (0.3, -0.2, 0.1))
    registration = register([wrong, right], match, match, CONFIG)
    assert registration.refined
    np.testing.assert_allclose(registration.T_match_query, np.eye(4), atol=2e-3)


def test_a_start_that_goes_on_alone_ends_where_it_would_have_ended_without_the_others():
    match = surface()
    wrong, right = se3.from_yaw(1.0, (20.0, 5.0, 0.0)), se3.from_yaw(0.02, (0.3, -0.2, 0.1))
    alone, chosen = (register(starts, match, match, CONFIG) for starts in ([right], [wrong, right]))
    np.testing.assert_allclose(chosen.T_match_query, alone.T_match_query, atol=1e-6)
    assert (chosen.agreement, len(chosen.left_out)) == (alone.agreement, 1)


def test_a_start_that_was_left_out_too_early_is_found_again():
    match = surface()
    beside, right = se3.from_yaw(1.0, (3.0, 5.0, 0.0)), se3.from_yaw(0.1, (1.5, -1.0, 1.2))
    at_once = replace(CONFIG, first_rounds=0)
    chosen = register([beside, right], match, match, at_once)
    assert np.linalg.norm(chosen.T_match_query[:3, 3]) > 1.0
    again = reconsider(chosen, match, match, at_once)
    assert again is not None and again.agreement > chosen.agreement
    np.testing.assert_allclose(again.T_match_query, np.eye(4), atol=2e-3)
    assert reconsider(again, match, match, at_once) is None


def test_a_start_on_which_too_little_of_what_stands_agrees_is_not_refined():
    strict = replace(CONFIG, min_overlap=1.0)
    apart = se3.from_yaw(1.0, (3.0, 5.0, 0.0))
    assert not register([apart], surface(1), surface(1), strict).refined
    assert register([np.eye(4)], surface(1), surface(1), strict).refined


def test_a_start_on_which_too_few_points_agree_is_not_refined():
    registration = register([np.eye(4)], surface(1), surface(2), replace(CONFIG, min_agreement=1.0))
    assert not registration.refined


def test_three_planes_fix_a_pose_and_two_of_a_corridor_or_one_do_not():
    floor, front, side = plane((0.0, 0.0, 1.0)), plane((1.0, 0.0, 0.0)), plane((0.0, 1.0, 0.0))
    room = joined(floor, front, side)
    corridor = joined(floor, side, plane((0.0, -1.0, 0.0)))
    values = [observability(information(one.points, one.normals), CONFIG.lever) for one in (room, corridor, floor)]
    assert CONFIG.min_observability < values[0] <= 1.0 / 6.0
    assert values[1] < 1e-9 and values[2] < 1e-9


def test_observability_is_the_share_of_the_smallest_eigenvalue_with_rotations_at_the_lever():
    assert observability(np.eye(6), 1.0) == pytest.approx(1 / 6)
    assert observability(np.diag([1.0, 1.0, 1.0, 225.0, 225.0, 225.0]), 15.0) == pytest.approx(1 / 6)
    assert observability(np.diag([0.5, 1.0, 1.0, 1.0, 1.0, 1.5]), 1.0) == pytest.approx(0.5 / 6)
    assert observability(np.zeros((6, 6)), 15.0) == 0.0


def test_information_of_a_floor_is_that_of_its_heights_and_tilts():
    floor = plane((0.0, 0.0, 1.0))
    x, y, count = floor.points[:, 0], floor.points[:, 1], len(floor.points)
    expected = np.zeros((6, 6))
    expected[np.ix_([2, 3, 4], [2, 3, 4])] = np.diag([count, (y**2).sum(), (x**2).sum()])
    np.testing.assert_allclose(information(floor.points, floor.normals), expected, atol=1e-9)


def test_contact_is_near_a_point_near_its_plane_and_facing_alike():
    wall = plane((1.0, 0.0, 0.0))
    for offset, touches in (((0.2, 0.3, 0.0), True), ((0.3, 0.0, 0.0), False), ((0.0, 90.0, 0.0), False)):
        found = contact(wall.shifted(np.array(offset)), wall, CONFIG)
        assert found.touching.all() == touches == found.touching.any()
    assert not contact(replace(wall, normals=-wall.normals), wall, CONFIG).touching.any()
    near = contact(wall.shifted(np.array([0.2, 0.3, 0.0])), wall, CONFIG)
    np.testing.assert_allclose(near.residuals, 0.2)
    np.testing.assert_array_equal(near.rows, np.arange(len(wall.points)))


@pytest.mark.parametrize("reach", [1.0, 3.0])
@pytest.mark.parametrize("seed", range(3))
def test_the_compiled_icp_takes_the_plain_steps(reach, seed):
    rng = np.random.default_rng(seed)
    query, match = surface(seed + 1, 800), surface(seed + 1)
    pose = se3.exp(np.concatenate([rng.normal(0, 0.2, 3), rng.normal(0, 0.02, 3)]))
    for _ in range(3):
        pairs = find_counterparts(query.moved(pose), match, reach)
        expected = se3.exp(gauss_newton_step(pairs, reach)) @ pose
        found = iterate(pose, query, match, reach, 1)
        np.testing.assert_allclose(found, expected, atol=1e-9)
        pose = found


@pytest.mark.parametrize("seed", range(3))
def test_the_compiled_contact_is_the_plain_one(seed):
    query, match = surface(seed + 1, 800).moved(se3.exp([0.1, 0.05, 0.02, 0.0, 0.01, 0.02])), surface(seed + 1)
    gaps, nearest = match.tree.query(query.points, distance_upper_bound=CONFIG.neighbour_distance)
    rows = np.where(np.isfinite(gaps), nearest, 0)
    residuals = np.einsum("ij,ij->i", query.points - match.points[rows], match.normals[rows])
    facing = np.einsum("ij,ij->i", query.normals, match.normals[rows])
    good = np.isfinite(gaps) & (np.abs(residuals) < CONFIG.surface_distance) & (facing > 0.6)
    found = contact(query, match, CONFIG)
    assert np.array_equal(found.touching, good)
    assert np.array_equal(found.rows, rows[good])
    np.testing.assert_allclose(found.residuals, residuals[good], atol=1e-12)


@pytest.mark.parametrize(("spread", "count"), [(1.0, 500), (4e4, 500), (1.0, 17), (1.0, 1), (1.0, 0)])
def test_each_patch_is_nearest_to_itself_on_a_grid_and_far_apart(spread, count):
    points = spread * np.random.default_rng(count).uniform(-50, 50, (count, 3))
    normals = np.tile([0.0, 0.0, 1.0], (count, 1))
    patches = patches_of(points, normals, 1.0)
    assert (len(patches.grid) == 0) == (spread > 1.0)
    rows, distances = touching_rows(points, normals, patches, 1.0, 1.0, 0.25, 0.6)
    assert np.array_equal(patches.rows[rows], np.arange(count))
    np.testing.assert_allclose(distances, 0.0, atol=0.1)  # coordinates of single precision
