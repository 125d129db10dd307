"""Where registration starts: the right turn and shift by phase correlation, the right height by the ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import fft
from scipy.ndimage import map_coordinates

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se2 import PlanarPose, angle_between, turned
from revisit.core.place import Place
from revisit.core.verification.oriented_points import COLUMN_M
from revisit.core.verification.phase_correlation import best_shift
from revisit.core.verification.start import IMAGE_SIZE, correlate, find_start, lift, polar_amplitude, raster
from tests.support.yards import moved, place_of_points, recognised, thinned, yard

CONFIG = VerificationConfig()


def plan(seed: int = 0) -> np.ndarray:
    """Points of random walls seen from above (n, 2)."""
    rng = np.random.default_rng(seed)
    starts, directions = rng.uniform(-35, 35, (25, 1, 2)), rng.uniform(0, np.pi, 25)
    along = np.linspace(0, 12, 40)[None, :, None] * np.stack([np.cos(directions), np.sin(directions)], 1)[:, None]
    return (starts + along).reshape(-1, 2)


def standing_place(points: np.ndarray) -> Place:
    """Upright posts at `points` (n, 2), nothing else."""
    upright = np.c_[points, np.zeros(len(points))]
    return place_of_points(upright, np.tile([1.0, 0.0, 0.0], (len(upright), 1)))


def test_a_point_is_drawn_in_its_pixel_and_blurred_to_its_neighbours():
    image = raster(np.array([[2.5, -1.5]]), 1.0)
    row, column = np.unravel_index(image.argmax(), image.shape)
    assert (column - IMAGE_SIZE // 2, row - IMAGE_SIZE // 2) == (2, -2)
    lifted = image - image.min()
    assert lifted[row, column] == pytest.approx(np.log(2.0))
    assert lifted[row + 1, column] == lifted[row, column - 1] == pytest.approx(0.5 * np.log(2.0))
    assert image.sum() == pytest.approx(0.0, abs=1e-9) and (lifted > 1e-12).sum() == 5


def test_points_outside_the_image_are_left_out():
    inside, far = np.array([[1.0, 1.0]]), np.array([[1e4, 0.0], [0.0, -1e4]])
    np.testing.assert_array_equal(raster(np.r_[inside, far], 0.8), raster(inside, 0.8))


@pytest.mark.parametrize("shift", [(0, 0), (7, -3), (-20, 11)])
def test_phase_correlation_finds_a_known_shift_exactly(shift):
    image = raster(plan(), 0.8)
    peak, found = best_shift(fft.rfft2(image), fft.rfft2(np.roll(image, shift[::-1], axis=(0, 1))), half_turn=False)
    np.testing.assert_array_equal(found, shift)
    assert peak == pytest.approx((image**2).sum())


@pytest.mark.parametrize("shift", [(0, 0), (7, -3), (-20, 11)])
def test_the_spectrum_of_an_image_serves_the_image_turned_by_half_a_turn_too(shift):
    image = raster(plan(), 0.8)
    upside_down = np.roll(raster(-plan(), 0.8), shift[::-1], axis=(0, 1))
    peak, found = best_shift(fft.rfft2(image), fft.rfft2(upside_down), half_turn=True)
    np.testing.assert_array_equal(found, shift)
    assert peak == pytest.approx((image**2).sum())


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.9])
def test_the_compiled_image_is_the_plain_one(yaw):
    points, pixel, half = plan(3), 0.8, IMAGE_SIZE // 2
    cells = np.floor(turned(points, yaw) / pixel).astype(int) + half
    cells = cells[((cells >= 0) & (cells < IMAGE_SIZE)).all(axis=1)]
    counts = np.zeros((IMAGE_SIZE, IMAGE_SIZE))
    np.add.at(counts, (cells[:, 1], cells[:, 0]), 1.0)
    image = np.log1p(counts)
    image = image + 0.5 * sum(np.roll(image, step, axis) for step in (-1, 1) for axis in (0, 1))
    np.testing.assert_allclose(raster(points, pixel, yaw), image - image.mean(), atol=1e-12)


@pytest.mark.parametrize("yaw_deg", [0.0, 37.0, 90.0, 155.0, -100.0])
def test_phase_correlation_finds_a_known_turn_and_shift(yaw_deg):
    true = PlanarPose(np.radians(yaw_deg), np.array([4.0, -6.0]))
    best = correlate(standing_place(plan()), standing_place(true.apply(plan())), CONFIG)[0]
    assert angle_between(np.array([best.yaw]), true.yaw)[0] <= np.radians(1.5)
    assert np.linalg.norm(best.translation - true.translation) < 2 * CONFIG.correlation_pixel


def test_the_polar_amplitude_of_half_a_spectrum_is_that_of_the_whole_one():
    image = raster(plan(), CONFIG.correlation_pixel)
    amplitude = np.log1p(np.abs(np.fft.fftshift(np.fft.fft2(image))))
    angle, radius = np.radians(np.arange(180.0))[:, None], np.arange(3.0, 45.0)[None, :]
    middle = IMAGE_SIZE // 2
    polar = map_coordinates(amplitude, [middle + radius * np.sin(angle), middle + radius * np.cos(angle)], order=1)
    expected = polar - polar.mean(axis=0)
    np.testing.assert_allclose(polar_amplitude(np.fft.rfft2(image)), expected, rtol=0, atol=1e-9)


def test_phase_correlation_looks_only_at_what_stands():
    place = recognised(yard(1))[1]
    buried = replace(
        place, points=np.r_[place.points[: place.standing_count], place.points[place.standing_count :] * 0]
    )
    for one, other in zip(correlate(place, place, CONFIG), correlate(buried, place, CONFIG), strict=True):
        assert one.yaw == other.yaw
        np.testing.assert_array_equal(one.translation, other.translation)


def test_a_lifted_pose_takes_the_height_of_the_common_ground():
    flat = np.array([[x, y, -1.5] for x in np.arange(-20.0, 20.0) for y in np.arange(-20.0, 20.0)])
    normals = np.tile([0.0, 0.0, 1.0], (len(flat), 1))
    posts = flat + [0.0, 0.0, 3.0]  # stands on the ground and must not raise it
    query = place_of_points(np.r_[posts, flat], np.r_[normals, normals])
    match = place_of_points(flat + [0.0, 0.0, 0.7], normals)
    lifted = lift(PlanarPose(0.3, np.array([2.0, 1.0])), query, match)
    np.testing.assert_allclose(lifted, se3.from_yaw(0.3, (2.0, 1.0, 0.7)), atol=1e-6)


def test_a_lifted_pose_rises_by_the_median_of_the_lowest_points_of_common_columns():
    rng = np.random.default_rng(8)
    clouds = [np.c_[rng.uniform(-20, 20, (400, 2)), rng.uniform(-2, 1, 400)].astype(np.float32) for _ in range(2)]
    query, match = (place_of_points(cloud, np.tile([0.0, 0.0, 1.0], (400, 1))) for cloud in clouds)
    pose = PlanarPose(0.4, np.array([3.0, -2.0]))

    def lowest(points: np.ndarray) -> dict[tuple[int, int], float]:
        found: dict[tuple[int, int], float] = {}
        for x, y, z in points:
            column = (int(np.floor(x / COLUMN_M)), int(np.floor(y / COLUMN_M)))
            found[column] = min(found.get(column, np.inf), z)
        return found

    ours, theirs = lowest(se3.apply(pose.lifted(), query.points)), lowest(match.points)
    rises = [theirs[column] - ours[column] for column in ours.keys() & theirs.keys()]
    assert len(rises) > 50
    assert lift(pose, query, match)[2, 3] == pytest.approx(float(np.median(rises)), abs=1e-6)


def test_places_without_a_common_column_stay_at_their_height():
    here, normals = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
    pose = PlanarPose(0.0, np.array([90.0, 0.0]))
    query, match = place_of_points(here, normals), place_of_points(here + [0.0, 0.0, 5.0], normals)
    np.testing.assert_array_equal(lift(pose, query, match), pose.lifted())


def test_images_are_correlated_only_where_too_few_keypoints_agree():
    place = recognised(yard(1))[1]
    assert len(find_start(place, place, CONFIG).poses) == 1
    unsure = replace(CONFIG, sure_inliers=10**6)
    assert len(find_start(place, place, unsure).poses) == CONFIG.starts


def test_the_start_of_a_revisit_is_near_enough_for_icp():
    T_match_query = se3.from_yaw(2.0, (4.0, -3.0, 0.5))
    query = recognised(thinned(moved(yard(1), se3.inverse(T_match_query)), 0.7, seed=3))[1]
    start = find_start(query, recognised(yard(1))[1], CONFIG)
    error = se3.inverse(T_match_query) @ start.poses[0]
    assert start.fit.inliers >= CONFIG.sure_inliers
    assert np.linalg.norm(error[:3, 3]) < 1.0 and se3.rotation_angle(error) < np.radians(3.0)


def rows_of_tables(seed: int) -> np.ndarray:
    """Points of four rows of tables every 12 m, seen from above (n, 2): half a turn makes nearly the same of them."""
    rng = np.random.default_rng(seed)
    along = np.concatenate([np.linspace(x, x + 9.0, 25) for x in np.arange(-36.0, 36.0, 12.0)])
    rows = np.concatenate([np.c_[along, np.full_like(along, y)] for y in (-10.5, -3.5, 3.5, 10.5)])
    return rows + rng.normal(0.0, 0.05, rows.shape)


def test_where_the_two_directions_of_a_turn_fit_alike_both_are_starts():
    true = PlanarPose(np.radians(140.0), np.array([1.0, -2.0]))
    query, match = standing_place(rows_of_tables(1)), standing_place(true.apply(rows_of_tables(2)))
    poses = find_start(query, match, CONFIG).poses
    assert len(poses) == CONFIG.starts + 1
    turns = [float(np.arctan2(pose[1, 0], pose[0, 0])) for pose in poses[1:]]
    assert angle_between(np.array([turns[0]]), turns[1])[0] == pytest.approx(np.pi, abs=1e-6)
    assert min(angle_between(np.array(turns), true.yaw)) <= np.radians(1.5)


def test_where_one_direction_fits_best_or_other_turns_do_as_well_there_is_no_further_start():
    irregular, rows = standing_place(plan()), standing_place(rows_of_tables(1))
    assert len(find_start(irregular, standing_place(plan() + [3.0, 1.0]), CONFIG).poses) == CONFIG.starts
    assert len(find_start(rows, rows, replace(CONFIG, opposite_clear=0.0)).poses) == CONFIG.starts
    assert len(find_start(rows, rows, replace(CONFIG, starts=1)).poses) == 1
