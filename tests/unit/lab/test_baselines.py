"""The baselines on clouds small enough to work out by hand, and the invariances their papers promise."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from lab.baselines.augmented_scan_context import AugmentedScanContext
from lab.baselines.catalogue import ALL_BASELINES
from lab.baselines.lidar_iris import LidarIris
from lab.baselines.m2dp import M2dp
from lab.baselines.ndt_histogram import NdtHistogram
from lab.baselines.plane_edges import PlaneEdges
from lab.baselines.ring import Ring
from lab.baselines.ring_plus_plus import RingPlusPlus
from lab.baselines.solid import Solid
from lab.baselines.stable_triangles import StableTriangles
from lab.baselines.triangles import Triangles
from revisit.core.geometry import se3
from revisit.evaluation.baselines import PlaceRecogniser, ScanContext


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


@functools.cache
def described(method: PlaceRecogniser) -> np.ndarray:
    """Thirty places, described once for all tests."""
    return np.stack([method.describe(place(seed)) for seed in range(30)])


# The voxels and pixels of STD follow the frame: of a few walls turned at will it keeps too few corners.
BLIND_TO_TURNS = [method for method in ALL_BASELINES if not isinstance(method, StableTriangles)]


@pytest.mark.parametrize("method", BLIND_TO_TURNS, ids=lambda method: method.name)
@pytest.mark.parametrize("degrees", [0.0, 37.0, 180.0, 271.0])
def test_a_turned_place_is_told_from_thirty_others(method: PlaceRecogniser, degrees: float) -> None:
    places = described(method)
    for seed in range(0, 30, 10):
        query = method.describe(seen_from(place(seed), np.radians(degrees)))
        assert int(method.similarities(query, places).argmax()) == seed


@pytest.mark.parametrize("method", ALL_BASELINES, ids=lambda method: method.name)
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


def test_the_augmented_context_finds_a_place_passed_on_the_next_lane_as_alike_as_the_place_itself() -> None:
    method, cloud = AugmentedScanContext(), place(1)
    seen, here = method.describe(seen_from(cloud, np.radians(90.0), x=2.0)), method.describe(cloud)
    aside = method.similarities(seen, here[None])[0]
    assert aside == pytest.approx(1.0, abs=1e-5)
    assert method.context.similarities(seen[0], here[None, 0])[0] < 0.99


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


def test_names_tell_the_baselines_apart() -> None:
    assert len({method.name for method in ALL_BASELINES}) == len(ALL_BASELINES)


def test_solid_weighs_ranges_by_how_much_their_elevations_see() -> None:
    # Two points on one elevation 10 m away, one point on another elevation 50 m away: 2 counts and 1 count over
    # 32 elevations of which most see nothing, so the weights are 1 and 1/2.
    method = Solid(lowest_deg=-16.0, highest_deg=16.0)
    points = np.array([[10, 0, 0.1], [0, 10, 0.1], [50, 0, -5.0]], dtype=np.float32)
    descriptor = method.describe(points)
    assert descriptor.shape == (100,)
    assert descriptor[5] == pytest.approx(2.0) and descriptor[25] == pytest.approx(0.5)
    assert descriptor[40] == pytest.approx(1.5) and descriptor[40 + 15] == pytest.approx(1.0)
    assert np.count_nonzero(descriptor) == 4


def test_solid_finds_the_yaw_in_its_counts_by_azimuth() -> None:
    method, cloud = Solid(), place(1)
    query = method.describe(seen_from(cloud, np.radians(90.0)))
    assert method.yaw_shift(query, method.describe(cloud)) == 15
    np.testing.assert_allclose(query[:40], method.describe(cloud)[:40], rtol=1e-3, atol=1.0)


def test_lidar_iris_sets_one_bit_for_each_height_slice_that_is_occupied() -> None:
    # Slices are 1 m high from -3 m: 0.5 m is slice 3, -2.9 m slice 0. (10.5, 0.1) is ring 10, degree 0.
    points = np.array([[10.5, 0.1, 0.5], [10.5, 0.1, -2.9], [-20.5, 0.1, 4.9]], dtype=np.float32)
    image = LidarIris().describe(points)[:80]
    assert image[10, 0] == 0b00001001 and image[20, 179] == 0b10000000
    assert np.count_nonzero(image) == 2


def test_lidar_iris_finds_the_yaw_to_the_degree() -> None:
    method, cloud = LidarIris(), place(1)
    query = method.describe(seen_from(cloud, np.radians(37.0)))
    assert method.yaw_shift(query, method.describe(cloud)) == 37


def test_ndt_cells_are_classed_by_the_shape_of_their_points() -> None:
    rng = np.random.default_rng(0)
    wire = np.column_stack([rng.uniform(0.1, 0.9, 50), np.full((50, 2), 0.5)]) + rng.normal(0, 0.005, (50, 3))
    wall = np.column_stack([rng.uniform(0.1, 0.9, 50), np.full(50, 0.5), rng.uniform(0.1, 0.9, 50)])
    bush = rng.uniform(0.1, 0.9, (50, 3))
    parts = [wire, wall + [2, 0, 0], bush + [4, 0, 0], wire[:4] + [8, 0, 0]]
    histogram = NdtHistogram().describe(np.concatenate(parts).astype(np.float32))[0].reshape(6, 11)
    # Ranges end at 3, 6, 9 m: wire and wall lie in the first, the bush in the second; four points are too few.
    assert histogram[0, 1] == 1 and histogram[0, 2:].sum() == 1 and histogram[1, 0] == 1
    assert histogram.sum() == 3


def test_ndt_histograms_do_not_depend_on_the_heading() -> None:
    method = NdtHistogram()
    rng = np.random.default_rng(2)
    walls = [np.column_stack([rng.uniform(-20, 20, 8000), np.full(8000, y), rng.uniform(-1, 4, 8000)]) for y in (6, -9)]
    house = np.concatenate(
        walls + [np.column_stack([np.full(3000, 15.0), rng.uniform(-9, 6, 3000), rng.uniform(-1, 4, 3000)])]
    )
    straight = method.describe(house.astype(np.float32))
    turned = method.describe(seen_from(house, np.radians(50.0)))
    assert method.similarities(turned, straight[None])[0] > 0.9


def test_triangles_of_three_posts_have_their_distances_as_sides() -> None:
    heights = np.linspace(-1.5, 3.0, 10)
    posts = [
        np.column_stack([np.full((10, 1), x), np.full((10, 1), y), heights])
        for x, y in ((0.2, 0.2), (4.2, 0.2), (0.2, 6.2))
    ]
    rows = Triangles().describe(np.concatenate(posts).astype(np.float32))
    assert np.isfinite(rows[:, 0]).sum() == 1
    np.testing.assert_allclose(rows[0, :3], [4.0, 6.0, np.sqrt(52.0)], atol=1e-4)
    # Corners are given opposite to their sides: the shortest side lies opposite to the far post.
    np.testing.assert_allclose(rows[0, 3:5], [0.2, 6.2], atol=1e-4)


def test_triangles_of_another_place_do_not_agree_on_a_pose() -> None:
    method = Triangles()
    here, there = method.describe(place(4)), method.describe(place(5))
    moved = method.describe(seen_from(place(4), 0.7, x=4.0, y=-3.0))
    same, other = method.similarities(here, np.stack([moved, there]))
    assert same > 3 * other


def test_a_place_without_upright_things_has_no_triangles_and_matches_nothing() -> None:
    flat = np.column_stack([np.random.default_rng(0).uniform(-30, 30, (500, 2)), np.full(500, -1.7)]).astype(np.float32)
    method = Triangles()
    rows = method.describe(flat)
    assert np.isnan(rows).all()
    assert method.similarities(rows, rows[None])[0] == 0.0


def test_ring_plus_plus_calls_a_wall_planar_and_a_wire_linear() -> None:
    rng = np.random.default_rng(1)
    spread = [rng.uniform(0, 1, 200), np.zeros(200), rng.uniform(0, 1, 200)]
    method = RingPlusPlus()
    wall, wire = (method._features(np.column_stack(columns)) for columns in (spread, [spread[0], *np.zeros((2, 200))]))
    assert wall[1].max() > 0.5 and wall[2].max() < 1e-3
    assert wire[0].max() > 0.99


def test_ring_plus_plus_hardly_changes_when_the_place_is_seen_from_a_few_metres_away() -> None:
    method = RingPlusPlus()
    here, moved = method.describe(place(2)), method.describe(seen_from(place(2), 0.0, x=3.0, y=-2.0))
    elsewhere = max(method.similarities(here, np.stack([method.describe(place(seed)) for seed in range(10, 30)])))
    assert method.similarities(here, moved[None])[0] > elsewhere


def yard() -> np.ndarray:
    """Level ground, and a box of 1 by 1 by 1.5 m on it at (10, 4)."""
    x, y = np.meshgrid(np.arange(-20, 20, 0.2), np.arange(-20, 20, 0.2))
    ground = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -1.7)])
    side, up = np.meshgrid(np.arange(0, 1, 0.1), np.arange(0, 1.5, 0.1))
    walls = [
        np.column_stack([10 + a.ravel(), 4 + b.ravel(), up.ravel() - 1.7])
        for a, b in ((side, 0 * side), (side, 0 * side + 1), (0 * side, side), (0 * side + 1, side))
    ]
    return np.concatenate([ground, *walls]).astype(np.float32)


def test_the_only_corner_beside_level_ground_is_the_top_of_the_box_on_it() -> None:
    pieces, corners = PlaneEdges().find(yard())
    assert len(corners.points) == 1
    np.testing.assert_allclose(corners.points[0], [10.5, 4.5, -0.3], atol=0.75)
    assert abs(corners.normals[0, 2]) == pytest.approx(1.0, abs=1e-6)
    assert len(set(pieces.planes)) == 1 and np.ptp(pieces.centres[:, 0]) > 30


def test_the_pose_of_matched_triangles_lays_planes_on_planes() -> None:
    method = StableTriangles()
    here, elsewhere = method.describe(place(4)), method.describe(place(5))
    assert method.similarities(here, np.stack([elsewhere, here])).argmax() == 1
    turn = se3.from_yaw(0.7, (4.0, -3.0, 0.5))
    asked = method.describe(place(4))[:, 6:].reshape(-1, 3, 3)
    corners = asked[~np.isnan(asked[:, 0, 0])].astype(np.float64)
    moved = se3.apply(turn, corners.reshape(-1, 3)).reshape(corners.shape)
    found = method._pose(corners.reshape(-1, 9), moved.reshape(-1, 9))
    assert found is not None
    np.testing.assert_allclose(found[0], turn[:3, :3], atol=1e-6)
    np.testing.assert_allclose(found[1], turn[:3, 3], atol=1e-5)


def test_fewer_than_four_agreeing_triangles_give_no_pose() -> None:
    rng = np.random.default_rng(0)
    assert StableTriangles()._pose(rng.uniform(0, 30, (3, 9)), rng.uniform(0, 30, (3, 9))) is None
    assert StableTriangles()._pose(rng.uniform(0, 30, (20, 9)), rng.uniform(0, 300, (20, 9))) is None
