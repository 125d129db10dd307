"""Rivals are sought by correlation of plans: its fast form counts what counting at every shift would."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.kernels.plan_images import occupied_around, plan_peaks, plan_shares
from revisit.core.verification.oriented_points import OrientedPoints
from revisit.core.verification.rivals import PLAN_SIZE, _layers, _overlap_plans, _plan

PIXEL_M = 0.8


def scene(seed: int) -> np.ndarray:
    """Points (n, 3) within the plan, none on the border of a pixel."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(-30, 30, (300, 2)) + rng.uniform(0.1, 0.9, (300, 2))
    return np.c_[cells * PIXEL_M, rng.uniform(-3, 6, 300)]


def _wider(images: np.ndarray) -> np.ndarray:
    """The largest value of each pixel and its eight neighbours; the edges go round."""
    along = np.maximum(np.maximum(np.roll(images, 1, -1), images), np.roll(images, -1, -1))
    return np.maximum(np.maximum(np.roll(along, 1, -2), along), np.roll(along, -1, -2))


def counted(query: np.ndarray, match: np.ndarray, shift: tuple[int, int]) -> tuple[float, float]:
    """The share of the query that stands on what stands, and how much of it was seen, moved by (x, y) pixels."""
    standing = _wider((_layers(match, PIXEL_M) > 0).astype(np.float32))
    seen = _wider(_wider((_layers(match, PIXEL_M).sum(axis=0, keepdims=True) > 0).astype(np.float32)))[0]
    layers = np.roll(_layers(query, PIXEL_M), shift[::-1], axis=(1, 2))
    common = float((layers * seen).sum())
    return float((layers * standing).sum()) / max(common, 1.0), common


@pytest.mark.parametrize("quarters", range(4))
def test_shares_of_all_turns_and_shifts_are_those_of_counting(quarters: int) -> None:
    query, match = scene(1), scene(2)
    against = _plan(OrientedPoints(match, np.zeros_like(match), len(match)), PIXEL_M)
    plans = _overlap_plans(query, against, 0.0, PIXEL_M)
    shares = plan_shares(plans.hits, plans.seen, 0.0)
    turned = query.copy()
    for _ in range(quarters):
        turned[:, :2] = np.c_[-turned[:, 1], turned[:, 0]]
    for shift in ((0, 0), (5, -3), (-17, 22), (1, 1)):
        share, common = counted(turned, match, shift)
        row, column = ((step - quarters // 2) % PLAN_SIZE for step in shift[::-1])
        assert shares[quarters, row, column] == pytest.approx(share, abs=1e-4)
        assert plans.seen[quarters, row, column] == pytest.approx(common, abs=1e-2)


def test_turns_in_which_too_little_is_hit_are_left_out():
    street = np.c_[np.linspace(-40, 40, 200), np.full(200, 3.3), np.full(200, 1.0)]
    against = _plan(OrientedPoints(street, np.zeros_like(street), len(street)), PIXEL_M)
    some, every = (_overlap_plans(street, against, least, PIXEL_M) for least in (0.5, 0.0))
    assert (some.quarters, every.quarters) == ([0, 2], [0, 1, 2, 3])
    assert every.hits[1].max() < 0.5 * every.hits[0, 0, 0] < every.hits[2].max()
    np.testing.assert_array_equal(some.hits, every.hits[::2])
    np.testing.assert_array_equal(some.seen, every.seen[::2])


def test_too_small_a_common_region_has_no_share():
    shares = plan_shares(np.float32([[[3.0, 0.5, 8.0]]]), np.float32([[[6.0, 0.5, 4.0]]]), 5.0)
    assert shares.tolist() == [[[0.5, 0.0, 0.0]]]
    assert plan_shares(np.float32([[[0.5]]]), np.float32([[[0.2]]]), 0.0).tolist() == [[[0.5]]]


def test_what_is_occupied_is_widened_as_by_the_largest_of_neighbours():
    points = np.random.default_rng(3).uniform((-52, -52, -4), (52, 52, 8), (400, 3))
    counts = (_layers(points, PIXEL_M) > 0).astype(np.float32)
    found = [occupied_around(points, PIXEL_M, PLAN_SIZE, 4, -2.0, 1.5, reach) for reach in (0, 1, 2)]
    for one, expected in zip(found, (counts, _wider(counts), _wider(_wider(counts))), strict=True):
        np.testing.assert_array_equal(one, expected)


def test_peaks_are_the_local_maxima_away_from_no_shift():
    share = np.random.default_rng(7).uniform(size=(4, PLAN_SIZE, PLAN_SIZE)).astype(np.float32)
    steps = np.minimum(np.arange(PLAN_SIZE), PLAN_SIZE - np.arange(PLAN_SIZE))
    highest = (share >= 0.9) & (share >= _wider(share))
    highest[0] &= np.hypot(steps[:, None], steps[None, :]) >= 30.0
    found = plan_peaks(share, 0.9, 30.0)
    assert len(found) > 100
    assert np.array_equal(found, np.argwhere(highest))
