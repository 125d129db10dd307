"""What one place has looked through contradicts what stands there in the other; what is hidden tells nothing."""

from __future__ import annotations

import numpy as np

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.verification.line_of_sight import _range_image, _with_neighbours, plain_seen_through, view_of
from revisit.core.verification.line_of_sight import seen_through as seen_through_of

CONFIG = VerificationConfig()


def seen_through(points: np.ndarray, seen: np.ndarray, config: VerificationConfig) -> tuple[int, int]:
    """What the view of `seen` says about `points`."""
    return seen_through_of(points, np.eye(4), view_of(seen, config.sight_angle), config)


def wall(distance_m: float, azimuth_deg: tuple[float, float] = (-30.0, 30.0)) -> np.ndarray:
    """A round wall about the origin, 4 m tall from 1.5 m below the sensor, a point every degree and every 0.4 m."""
    azimuth = np.radians(np.arange(*azimuth_deg, 1.0))
    height = np.arange(-1.5, 2.5, 0.4)
    angle, z = (grid.ravel() for grid in np.meshgrid(azimuth, height))
    return np.column_stack([distance_m * np.cos(angle), distance_m * np.sin(angle), z])


def test_a_wall_before_the_one_that_was_seen_was_looked_through() -> None:
    # At 10 m a wall of 4 m fills more of the view than at 20 m: only where there is a wall behind it, it is judged.
    through, judged = seen_through(wall(10.0, (-20.0, 20.0)), wall(20.0), CONFIG)
    assert through == judged > 150


def test_the_same_wall_and_one_within_the_margin_are_confirmed() -> None:
    for distance_m in (20.0, 18.5, 21.5):
        through, judged = seen_through(wall(distance_m, (-20.0, 20.0)), wall(20.0), CONFIG)
        assert through == 0
        assert judged > 300


def test_what_is_hidden_and_where_nobody_looked_tell_nothing() -> None:
    assert seen_through(wall(30.0), wall(20.0), CONFIG) == (0, 0)
    assert seen_through(wall(10.0, (90.0, 150.0)), wall(20.0), CONFIG) == (0, 0)


def test_beside_the_edge_of_something_near_nothing_counts_as_looked_through() -> None:
    post = wall(10.0, (0.0, 3.0))
    scene = np.concatenate([wall(20.0), wall(10.0, (-4.0, -1.0))])
    assert seen_through(post, scene, CONFIG)[0] == 0
    assert seen_through(post, wall(20.0), CONFIG)[0] > 0


def test_what_is_very_near_or_far_is_not_judged() -> None:
    assert seen_through(wall(3.0), wall(20.0), CONFIG) == (0, 0)
    assert seen_through(wall(45.0), wall(60.0), CONFIG) == (0, 0)


def test_azimuth_goes_round() -> None:
    behind = wall(10.0, (175.0, 185.0))
    through, judged = seen_through(behind, wall(20.0, (150.0, 210.0)), CONFIG)
    assert through == judged > 0


def test_directions_are_those_of_the_arcus_tangent_next_to_the_edges_of_pixels_too() -> None:
    rng = np.random.default_rng(4)
    azimuth, elevation = (3.0 * rng.integers(*ends, 4000) for ends in ((-60, 61), (-20, 20)))
    beside = rng.choice([-1.0, 1.0], (2, 4000)) * 10.0 ** rng.uniform(-9, 0, (2, 4000))
    azimuth, elevation = np.radians(azimuth + beside[0]), np.radians(elevation + beside[1])
    level = np.cos(elevation)
    points = 20.0 * np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    view = view_of(points, CONFIG.sight_angle)
    expected = _range_image(points, CONFIG)
    np.testing.assert_array_equal(np.isfinite(view.ranges), np.isfinite(expected))
    np.testing.assert_array_equal(view.around, _with_neighbours(view.ranges))


def test_the_compiled_view_counts_what_the_plain_one_counts() -> None:
    rng = np.random.default_rng(2)
    points, seen = (rng.uniform((-35, -35, -4), (35, 35, 12), (1500, 3)) for _ in range(2))
    through, judged = plain_seen_through(points, seen, CONFIG)
    assert 0 < through < judged
    assert seen_through(points, seen, CONFIG) == (through, judged)
    T_view_points = se3.exp([4.0, -2.0, 0.3, 0.01, -0.02, 1.0])
    expected = plain_seen_through(se3.apply(T_view_points, points), seen, CONFIG)
    assert seen_through_of(points, T_view_points, view_of(seen, CONFIG.sight_angle), CONFIG) == expected
