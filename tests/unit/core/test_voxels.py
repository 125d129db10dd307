"""Voxel keys, the voxel table and what is built on them: exact, and in bounded memory at the limits of coordinates."""

from __future__ import annotations

import tracemalloc
from contextlib import contextmanager
from itertools import product

import numpy as np
import pytest

from revisit.core.clusters import euclidean_clusters, find_ground
from revisit.core.config import ClusterConfig, ImplicitMapConfig, PipelineConfig
from revisit.core.errors import BadField
from revisit.core.geometry.voxel_keys import first_rows, grouped, voxel_keys
from revisit.core.implicit_map.neural_points import MAX_NEURAL_POINTS, oriented
from revisit.core.kernels.elastic_points import FIRST_SCAN, MOMENTS, RECORD, VIEW, insert_returns
from revisit.core.kernels.gathered_returns import GatheredReturns
from revisit.core.kernels.nearest_points import nearest_points
from revisit.core.kernels.point_columns import MAX_GRID, columns_of
from revisit.core.kernels.surface_cells import enter_observed_corners, find_cells, list_corners, pieces_around
from revisit.core.kernels.voxel_families import beside, coded_neighbours, families_of
from revisit.core.kernels.voxel_table import VoxelTable, distinct_rows, find, slot_of, table_of, voxels_of
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import describe
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.core.surface import Surface
from revisit.core.surface.cells import cells_near_planes

FAR_M = 1e6  # 10 km at scene scale 0.01


@contextmanager
def at_most(mib: float):
    """The block may not hold more memory than that at any time."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < mib * 2**20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("span", [3, 1000, 2**21, 2**31 - 1, 2**40, 2**61])
@pytest.mark.parametrize("axes", [2, 3])
def test_voxel_keys_are_equal_and_ordered_as_the_voxels_are(span, axes):
    rng = np.random.default_rng(0)
    voxels = rng.integers(-span, span, (400, axes))
    voxels = np.concatenate([voxels, voxels[::3]])
    keys = voxel_keys(voxels)
    order = np.lexsort(voxels.T[::-1])
    changes = (voxels[order][1:] != voxels[order][:-1]).any(axis=1)
    assert np.array_equal(np.diff(keys[order]) > 0, changes)
    assert np.array_equal(np.diff(keys[order]) == 0, ~changes)


@pytest.mark.parametrize("greatest", [3, 10_000, 2**62])
def test_the_first_rows_of_keys_are_those_of_numpy(greatest):
    keys = np.random.default_rng(1).integers(0, greatest, 2_000)
    assert np.array_equal(first_rows(keys), np.unique(keys, return_index=True)[1])
    assert len(first_rows(keys[:0])) == 0


@pytest.mark.parametrize("greatest", [3, 10_000, 2**62])
def test_the_groups_of_keys_are_those_of_numpy(greatest):
    keys = np.random.default_rng(1).integers(0, greatest, 2_000)
    for some in (keys, keys[:1], keys[:0]):
        _, numbers, counts = np.unique(some, return_inverse=True, return_counts=True)
        for found, expected in zip(grouped(some), (numbers, counts), strict=True):
            assert np.array_equal(found, expected)


@pytest.mark.parametrize("span", [4, 3_000])
def test_the_first_row_of_each_voxel_is_found(span):
    voxels = np.random.default_rng(2).integers(-span, span, (3_000, 3)).astype(np.int32)
    voxels = np.concatenate([voxels, voxels[::7]])
    expected = np.sort(np.unique(voxels, axis=0, return_index=True)[1])
    assert np.array_equal(distinct_rows(voxels), expected) and len(expected) <= 3_000
    assert len(distinct_rows(voxels[:0])) == 0


def test_no_voxels_have_no_keys():
    assert voxel_keys(np.zeros((0, 3), np.int64)).shape == (0,)


def colliding_voxels() -> np.ndarray:
    """Voxels (n, 3) of different columns that share their slots in a table of 2^20."""
    slots = np.zeros(1 << 20, np.int32)
    rows: dict[int, tuple[int, int]] = {}
    for x in range(40):
        for y in range(5000):
            slot = slot_of(slots, x * 37, y, 0)
            if slot in rows and len({x * 37, rows[slot][0]}) == 2:
                return np.array([[*rows[slot], 0], [x * 37, y, 0], [*rows[slot], 1], [x * 37, y, 1]], np.int32)
            rows[slot] = (x * 37, y)
    raise AssertionError("no collision among 200,000 columns")


def test_voxels_that_share_a_slot_are_all_found():
    voxels = colliding_voxels()
    table = table_of(voxels)
    assert [find(table, *(int(v) for v in voxel)) for voxel in voxels] == [0, 1, 2, 3]
    assert find(table, 5, 5, 5) == -1


def test_no_occupied_voxel_is_dropped_where_voxels_share_a_slot():
    positions = ((colliding_voxels() + 0.5) * 0.4).astype(np.float32)
    accumulator = GatheredReturns(0.4, 0, MAX_NEURAL_POINTS)
    accumulator.insert(positions, np.zeros(3, np.float32), 0)
    assert len(oriented(accumulator.records, 0.4)) == 4
    indices, squared = nearest_points(positions, columns_of(positions, 0.4), 0.4, 4, 2)
    assert indices[:, 0].tolist() == [0, 1, 2, 3]
    assert np.allclose(squared[:, 0], 0.0)


@pytest.mark.parametrize("spread", [20.0, 3000.0])
def test_neighbours_are_those_of_brute_force_and_of_equals_the_lower_voxel(spread):
    rng = np.random.default_rng(6)
    clumps = rng.uniform(-spread, spread, (60, 1, 3)).round()
    voxels = np.unique((clumps + rng.integers(-2, 3, (60, 12, 3))).reshape(-1, 3), axis=0)
    positions = (voxels[rng.permutation(len(voxels))] + 0.5).astype(np.float32)
    columns = columns_of(positions, 1.0)
    assert (len(columns.grid) == 0) == (np.prod(columns.shape) > MAX_GRID) == (spread > 1000)
    queries = np.concatenate([positions[::3] + np.float32(0.5), rng.uniform(-spread, spread, (50, 3))]).astype(
        np.float32
    )
    indices, squared = nearest_points(queries, columns, 1.0, 6, 2)
    for query, found, gaps in zip(queries, indices, squared, strict=True):
        distance = ((positions - query) ** 2).sum(axis=1)
        order = np.lexsort((*positions.T[::-1], distance))
        near = order[distance[order] < 4.0][:6]
        assert found.tolist() == [*near.tolist(), *[-1] * (6 - len(near))]
        assert gaps[: len(near)].tolist() == distance[near].tolist()
        assert np.isinf(gaps[len(near) :]).all()


def test_no_points_have_no_neighbours():
    columns = columns_of(np.zeros((0, 3), np.float32), 0.4)
    assert nearest_points(np.zeros((2, 3), np.float32), columns, 0.4, 3, 2)[0].tolist() == [[-1] * 3] * 2


def test_as_many_neural_points_as_occupied_voxels_on_a_hundred_thousand_returns():
    rng = np.random.default_rng(1)
    points = rng.uniform(-60, 60, (100_000, 3)).astype(np.float32)
    accumulator = GatheredReturns(0.4, len(points), MAX_NEURAL_POINTS)
    accumulator.insert(points, np.zeros(3, np.float32), 0)
    assert len(oriented(accumulator.records, 0.4)) == len(np.unique(voxels_of(points, 0.4), axis=0))


def test_the_insertion_kernel_sums_what_numpy_sums():
    rng = np.random.default_rng(2)
    points = rng.uniform(-1, 1, (300, 3)).astype(np.float32)
    voxels = voxels_of(points, 0.4)
    table = VoxelTable(np.full(1 << 10, -1, np.int32), np.full(300, -1, np.int32), np.zeros((300, 3), np.int32))
    records = np.empty((300, RECORD))
    size, end = insert_returns(points, 0, np.zeros(3, np.float32), 7, table, records, 0, 0.4, 300)
    assert size == len(np.unique(voxels, axis=0)) and end == 300
    for row in range(size):
        inside = points[(voxels == table.voxels[row]).all(axis=1)].astype(np.float64)
        second = inside.T @ inside
        expected = [len(inside), *inside.sum(axis=0), *second[np.triu_indices(3)]]
        np.testing.assert_allclose(records[row, MOMENTS], expected, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(
            records[row, VIEW], (-inside / np.linalg.norm(inside, axis=1)[:, None]).sum(axis=0), atol=1e-5
        )
    assert (records[:size, FIRST_SCAN:] == [7, 7, 1]).all()


def test_insertion_waits_for_room_and_goes_on_where_it_stopped():
    points = np.random.default_rng(8).uniform(-60, 60, (150_000, 3)).astype(np.float32)
    accumulator = GatheredReturns(0.4, 0, 70_000)
    accumulator.insert(points[:90_000], np.zeros(3, np.float32), 0)
    accumulator.insert(points[90_000:], np.zeros(3, np.float32), 1)
    voxels = voxels_of(points, 0.4)
    order = np.sort(np.unique(voxels, axis=0, return_index=True)[1])
    expected = {tuple(voxel) for voxel in voxels[order[:70_000]].tolist()}
    assert {tuple(voxel) for voxel in voxels_of(oriented(accumulator.records, 0.4).positions, 0.4).tolist()} == expected


def plain_cells(
    positions: np.ndarray, normals: np.ndarray, resolution: float, observed: float
) -> list[tuple[int, int, int]]:
    """The cells of `cells_near_planes`, in its order, by plain loops."""
    found: dict[tuple[int, int, int], None] = {}
    corners = np.array(list(np.ndindex(2, 2, 2)))
    for position, normal in zip(positions.astype(np.float64), normals.astype(np.float64), strict=True):
        home = np.floor(position / resolution).astype(int)
        for step in np.ndindex(3, 3, 3):
            cell = home + step - 1
            gaps = np.linalg.norm((cell + corners)[:, None] * resolution - positions, axis=2).min(axis=1)
            if abs(((cell + 0.5) * resolution - position) @ normal) <= 0.9 * resolution and gaps.max() <= observed:
                found[tuple(int(v) for v in cell)] = None
    return list(found)


def random_surface(count: int, reach: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return rng.uniform(-reach, reach, (count, 3)).astype(np.float32), normals.astype(np.float32)


def test_cells_near_planes_are_those_of_the_plain_formula_in_its_order():
    positions, normals = random_surface(200, 1.0)
    near = cells_near_planes(positions, normals, 0.4, 0.6)
    assert [tuple(cell) for cell in near.cells.tolist()] == plain_cells(positions, normals, 0.4, 0.6)
    assert len(near.cells) > 50
    steps = np.array([[c & 1, (c >> 1) & 1, (c >> 2) & 1] for c in range(8)])
    assert np.array_equal(near.corners[near.cell_corners], near.cells[:, None] + steps)
    assert len(np.unique(near.corners, axis=0)) == len(near.corners)
    gaps = np.linalg.norm(near.corners[:, None] * 0.4 - positions, axis=2).min(axis=1)
    assert gaps.max() <= 0.6 + 1e-6
    lattice = np.array(list(np.ndindex(12, 12, 12))) - 6
    assert len(near.corners) == (np.linalg.norm(lattice[:, None] * 0.4 - positions, axis=2).min(axis=1) <= 0.6).sum()


def test_pieces_of_corners_are_found_alike_in_a_grid_and_in_a_table():
    positions, normals = random_surface(300, 3.0)
    found = []
    for each in (0, 1_000):
        pieces = pieces_around(positions, 0.4, 0.6, each)
        corners, first = list_corners(pieces, enter_observed_corners(positions, 0.4, 0.6, pieces))
        found.append((corners, first, find_cells(positions, normals, 0.4, pieces, first, len(corners))))
        assert bool(len(pieces.grid)) == (each > 0)
    for one, other in zip(*found, strict=True):
        assert len(one) > 20
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("reach", [600.0, FAR_M])
def test_cells_of_far_returns_take_little_memory(reach):
    corners = np.array([[-1, -1, -1], [1, 1, 1], [1, -1, 1], [-1, 1, -1]], np.float32) * np.float32(reach)
    up = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    cells_near_planes(corners, up, 0.4, 0.8)
    with at_most(20):
        near = cells_near_planes(corners, up, 0.4, 0.8)
    assert len(near.cells) >= 4


def surface_of(vertices: np.ndarray) -> Surface:
    empty = np.zeros((0, 3), np.int32)
    normals = np.tile(np.array([0, 0, 1], np.float32), (len(vertices), 1))
    return Surface(vertices.astype(np.float32), normals, empty, empty, np.zeros(0, np.float32), 0.4)


def test_clusters_and_ground_of_far_returns_take_little_memory_and_are_right():
    rng = np.random.default_rng(4)
    places = np.array([[-FAR_M, -FAR_M, -FAR_M], [FAR_M, FAR_M, FAR_M], [FAR_M, -FAR_M, 0.0], [0.0, 0.0, 0.0]])
    vertices = (places[:, None] + rng.uniform(-0.1, 0.1, (4, 50, 3))).reshape(-1, 3).astype(np.float32)
    with at_most(20):
        labels = euclidean_clusters(vertices, 0.8)
        ground = find_ground(surface_of(vertices), ClusterConfig())
    assert np.array_equal(labels, np.unique(np.repeat([0, 3, 2, 1], 50), return_inverse=True)[1])
    assert ground.shape == (200,)


def test_neural_points_at_the_limits_of_coordinates_stay_apart():
    points = np.array([[FAR_M, FAR_M, -FAR_M], [-FAR_M, FAR_M, FAR_M], [0.1, 0.1, 0.1]], np.float32)
    accumulator = GatheredReturns(0.4, 0, MAX_NEURAL_POINTS)
    accumulator.insert(points, np.zeros(3, np.float32), 0)
    assert np.array_equal(oriented(accumulator.records, 0.4).positions, points)


def test_a_place_with_a_few_returns_at_the_limit_is_described_at_the_smallest_scale():
    rng = np.random.default_rng(5)
    walls = np.column_stack(
        [0.1 * np.sign(rng.normal(size=4000)), rng.uniform(-0.2, 0.2, 4000), rng.uniform(-0.02, 0.06, 4000)]
    )
    walls[2000:] = walls[2000:, [1, 0, 2]]
    far = np.array([[10_000, 10_000, 0], [-10_000, 10_000, 50], [10_000, -10_000, -50], [-10_000, -10_000, 9_000.0]])
    scan = Scan.validated(np.concatenate([walls, far]), np.eye(4), 0)
    submap = Submap(
        scan.points,
        np.zeros(4004, np.int32),
        np.zeros((1, 3), np.float32),
        np.zeros(1, np.int64),
        np.eye(4),
        np.zeros(3),
    )
    with at_most(200):
        described = describe(submap, load_packaged_models(), PipelineConfig(scene_scale=0.01))
    assert np.linalg.norm(described.descriptor.vector) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("scan_index", [[1, 0], [0, 2], [-1, 0], [0]])
def test_a_submap_whose_points_are_not_in_the_order_of_their_scans_is_refused(scan_index):
    with pytest.raises(BadField):
        Submap(
            np.zeros((2, 3), np.float32), np.array(scan_index, np.int32), np.zeros((2, 3), np.float32),
            np.zeros(2, np.int64), np.eye(4), np.zeros(3),
        )  # fmt: skip


def test_the_default_map_evicts_nothing_because_it_has_nothing_to_evict():
    assert "eviction_distance" not in ImplicitMapConfig.__dataclass_fields__


def test_neighbours_coded_before_a_voxel_are_those_of_the_plain_search():
    rng = np.random.default_rng(4)
    spread = np.unique(rng.integers(0, 12, (500, 3)), axis=0)
    nodes, child = spread >> 1, (spread & 1) @ [4, 2, 1]
    voxels = spread[np.lexsort([child, *nodes.T])].astype(np.int32)
    row_of = {tuple(voxel): row for row, voxel in enumerate(voxels.tolist())}
    side = [step for step in product((-1, 0, 1), repeat=3) if any(step)]
    side.sort(key=lambda step: sum(map(abs, step)))
    families = families_of(voxels)
    for row, (x, y, z) in enumerate(voxels.tolist()):
        around = [row_of.get((x + dx, y + dy, z + dz), len(voxels)) for dx, dy, dz in side]
        count = coded_neighbours(families, row)
        assert families.near[:count].tolist() == [other for other in around if other < row]
        found = {side[k] for k in range(6) if around[k] < len(voxels)}
        bits = [(-1, 0, 0), (0, -1, 0), (0, 0, -1), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
        assert beside(families) == sum(1 << bit for bit, step in enumerate(bits) if step in found)
