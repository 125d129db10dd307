"""How sure the height of a pose is, by the level surfaces that could meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from revisit.core.kernels.level_offsets import offset_counts
from revisit.core.verification import VerifiedLoop, verify
from revisit.core.verification.height_doubt import doubt_of_counts, height_doubt_m
from revisit.core.verification.oriented_points import OrientedPoints
from tests.support.yards import CONFIG, recognised, yard

Array = NDArray[np.float64]


def street(road_m: float, roofs_m: float, roofs: int, seed: int) -> OrientedPoints:
    """Walls on both sides of a road, drawn at random, and so many points of roofs above it."""
    rng = np.random.default_rng(seed)
    walls = np.stack([rng.uniform(-40, 40, 600), rng.choice([-8.0, 8.0], 600), rng.uniform(0, 6, 600)], axis=1)
    road = np.stack([rng.uniform(-40, 40, 300), rng.uniform(-7, 7, 300), np.full(300, road_m)], axis=1)
    cars = np.stack([rng.uniform(-40, 40, roofs), rng.uniform(-7, 7, roofs), np.full(roofs, roofs_m)], axis=1)
    normals = np.concatenate([np.tile((0.0, 1.0, 0.0), (600, 1)), np.tile((0.0, 0.0, 1.0), (300 + roofs, 1))])
    return OrientedPoints(np.concatenate([walls, road, cars]), normals, 600)


def test_pairs_are_counted_by_their_height_as_by_the_plain_formula() -> None:
    rng = np.random.default_rng(3)
    points, others = rng.uniform(-6, 6, (200, 3)), rng.uniform(-6, 6, (300, 3))
    apart = others[None] - points[:, None]
    near = np.linalg.norm(apart[..., :2], axis=2) <= 0.8
    heights, _ = np.histogram(apart[..., 2][near], bins=-3.0 + 0.1 * np.arange(61))
    assert heights.sum() > 100
    np.testing.assert_array_equal(offset_counts(points, others, 0.8, -3.0, 0.1, 60), heights)


@pytest.mark.parametrize("counts", [(0, 0), (300, 0), (300, 60), (0, 3)])
def test_a_height_at_which_most_lies_level_is_not_doubted(counts: tuple[int, int]) -> None:
    here, there = counts
    pairs = np.zeros(60, dtype=np.int64)
    pairs[30], pairs[43] = here, there
    assert doubt_of_counts(pairs) == 0.0


def test_a_height_is_the_less_sure_the_more_meets_elsewhere() -> None:
    pairs = np.zeros(60, dtype=np.int64)
    pairs[30], found = 100, []
    for pairs[43] in (40, 100, 500):
        found.append(doubt_of_counts(pairs))
    assert found == sorted(found) and 0.5 < found[0] < found[-1] < 1.7


def test_a_road_on_the_road_is_sure_and_a_road_on_roofs_is_not() -> None:
    empty, jam = street(0.0, 0.0, 0, 1), street(0.0, 1.5, 80, 2)
    on_road, on_roofs = np.eye(4), np.eye(4)
    on_roofs[2, 3] = -1.5
    assert height_doubt_m(jam, empty, on_road) < 0.1 < 1.0 < height_doubt_m(jam, empty, on_roofs)
    assert 1.0 < height_doubt_m(empty, jam, np.linalg.inv(on_roofs)) < 1.6


def test_what_looks_down_says_nothing_of_a_floor() -> None:
    """The ceiling under a storey is seen from below."""
    storey = street(0.0, 2.5, 300, 1)
    normals = storey.normals.copy()
    normals[900:, 2] = -1.0
    assert height_doubt_m(replace(storey, normals=normals), street(0.0, 0.0, 0, 2), np.eye(4)) == 0.0


def test_a_loop_tells_that_its_height_is_not_sure() -> None:
    """Two visits to a yard; at the second, tables stand nearly everywhere."""
    surface = yard(1)
    free = recognised(surface)[1]
    ground = np.flatnonzero(free.normals[:, 2] > 0.9)
    tables = free.points[ground] + np.float32((0.05, 0.05, 1.0))
    points = np.concatenate([free.points, tables]), np.concatenate([free.normals, free.normals[ground]])
    crowded = replace(free, points=points[0], normals=points[1])
    plain, doubted = (verify(place, free, 0.9, CONFIG.verification) for place in (replace(free), crowded))
    assert isinstance(plain, VerifiedLoop) and isinstance(doubted, VerifiedLoop)
    assert plain.measurement.covariance[2, 2] < 0.1**2
    assert 0.5**2 < doubted.measurement.covariance[2, 2] < 1.0
    assert doubted.measurement.covariance[0, 0] < 0.1**2
