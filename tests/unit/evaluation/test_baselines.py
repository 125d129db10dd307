"""The baselines on clouds small enough to work out by hand, and the invariances their papers promise."""

from __future__ import annotations

import numpy as np
import pytest

from core import se3
from evaluation.baselines import M2dp, PlaceRecogniser, Ring, ScanContext


def place(seed: int) -> np.ndarray:
    """Walls and posts at random around the sensor."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(12):
        start, heading = rng.uniform(-45, 45, 2), rng.uniform(0, np.pi)
        along = np.linspace(0, rng.uniform(5, 20), 120)
        wall = start + np.outer(along, [np.cos(heading), np.sin(heading)])
        heights = np.tile(np.linspace(-1.0, rng.uniform(1.0, 6.0), 6), (120, 1))
        parts.append(np.column_stack([np.repeat(wall, 6, axis=0), heights.ravel()]))
    return np.concatenate(parts).astype(np.float32)


def seen_from(points: np.ndarray, yaw: float, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    return se3.apply(se3.inverse(se3.from_yaw(yaw, (x, y, 0.0))), points).astype(np.float32)


METHODS = [ScanContext(), Ring(), M2dp()]


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
@pytest.mark.parametrize("degrees", [0.0, 37.0, 180.0, 271.0])
def test_a_turned_place_is_told_from_thirty_others(method: PlaceRecogniser, degrees: float) -> None:
    places = np.stack([method.describe(place(seed)) for seed in range(30)])
    for seed in range(0, 30, 6):
        query = method.describe(seen_from(place(seed), np.radians(degrees)))
        assert int(method.similarities(query, places).argmax()) == seed


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_the_same_cloud_is_as_alike_as_can_be(method: PlaceRecogniser) -> None:
    descriptor = method.describe(place(3))
    assert method.similarities(descriptor, descriptor[None])[0] == pytest.approx(1.0, abs=1e-5)


def test_scan_context_holds_the_greatest_height_of_each_bin() -> None:
    # Rings are 4 m wide, sectors 6 degrees: (10, 1) is ring 2, sector 0; (-10, -0.1) ring 2, sector 30.
    points = np.array([[10, 1, 0.5], [10, 1, 1.5], [-10, -0.1, -1.0], [200, 0, 9]], dtype=np.float32)
    context = ScanContext().describe(points)
    assert context.shape == (20, 60)
    assert context[2, 0] == pytest.approx(3.5) and context[2, 30] == pytest.approx(1.0)
    assert np.count_nonzero(context) == 2


def test_scan_context_finds_the_yaw_by_shifting_columns() -> None:
    method, cloud = ScanContext(), place(1)
    query = method.describe(seen_from(cloud, np.radians(90.0)))
    # The robot turned left by 90 degrees sees everything 15 sectors of 6 degrees further right.
    assert method.yaw_shift(query, method.describe(cloud)) == 15


def test_scan_context_compares_only_the_candidates_of_the_ring_key() -> None:
    places = np.stack([ScanContext().describe(place(seed)) for seed in range(30)])
    found = ScanContext(ring_key_candidates=5).similarities(places[7], places)
    assert np.count_nonzero(found > -1.0) == 5 and int(found.argmax()) == 7


def test_ring_hardly_changes_when_the_place_is_seen_from_a_few_metres_away() -> None:
    method = Ring()
    here = method.describe(place(2))
    moved = method.describe(seen_from(place(2), 0.0, x=3.0, y=-2.0))
    elsewhere = max(method.similarities(here, np.stack([method.describe(place(seed)) for seed in range(10, 30)])))
    assert method.similarities(here, moved[None])[0] > elsewhere


def test_m2dp_has_the_papers_length_and_unit_parts() -> None:
    descriptor = M2dp().describe(place(0))
    assert descriptor.shape == (4 * 16 + 8 * 16,)
    np.testing.assert_allclose([np.linalg.norm(descriptor[:64]), np.linalg.norm(descriptor[64:])], 1.0, atol=1e-5)
