"""Octrees of neural maps, their neighbours, and the normals that these let expect (docs/decisions/0287)."""

from __future__ import annotations

import zlib
from itertools import product

import numpy as np

from revisit.core.codec.neural_chances import fresh_mixtures
from revisit.core.geometry import octahedral
from revisit.core.kernels import expected_normals, mixed_octree
from revisit.core.kernels.expected_normals import EXPECTED, expect_normal, least_axis, octahedral_code
from revisit.core.kernels.mixed_octree import code_mixed_octree
from revisit.core.kernels.octree_coder import RANKS, THINNED_MODELS, Thinning, code_octree
from revisit.core.kernels.octree_nodes import STEPS, OctreeLevel, neighbours_of_all
from revisit.core.kernels.range_coder import finish, fresh_models, start

CRC_OF_TABLES = 0x5EDF3447
LOW = np.array([-9, -5, -3])


def spread(seed: int, depth: int = 4) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.unique(rng.integers(0, 1 << depth, (600, 3)), axis=0).astype(np.int32)


def written(voxels: np.ndarray, depth: int) -> tuple[OctreeLevel, np.ndarray]:
    data = np.zeros(8000, np.uint8)
    coder = start(data, False)
    level = code_mixed_octree(coder, data, fresh_mixtures().octree, voxels, LOW, depth, len(voxels))
    return level, data[: finish(coder, data)]


def test_an_octree_is_read_as_it_was_written_in_the_order_of_the_plain_one():
    voxels = spread(1)
    level, stream = written(voxels, 4)
    read = code_mixed_octree(start(stream, True), stream, fresh_mixtures().octree, voxels[:0], LOW, 4, len(voxels))
    data = np.zeros(8000, np.uint8)
    models, whole = fresh_models(THINNED_MODELS), Thinning((0, 0, 0), RANKS)
    plain = code_octree(start(data, False), data, models, voxels, 4, len(voxels), whole)
    assert np.array_equal(read.voxels, plain) and np.array_equal(level.voxels, plain)
    for one, other in zip(level, read, strict=True):
        assert np.array_equal(one, other)


def test_one_voxel_needs_no_bit():
    level, _ = written(np.zeros((1, 3), np.int32), 0)
    assert level.voxels.tolist() == [[0, 0, 0]] and neighbours_of_all(level).max() == -1


def test_neighbours_by_the_nodes_above_are_those_of_the_plain_search():
    level, _ = written(spread(2), 4)
    row_of = {tuple(voxel): row for row, voxel in enumerate(level.voxels.tolist())}
    around = neighbours_of_all(level)
    assert {tuple(step) for step in STEPS.tolist()} == set(product((-1, 0, 1), repeat=3)) - {(0, 0, 0)}
    for row, voxel in enumerate(level.voxels):
        assert around[row].tolist() == [row_of.get(tuple(beside), -1) for beside in (voxel + STEPS).tolist()]


def test_a_damaged_octree_gives_no_more_voxels_than_were_asked_for():
    voxels = spread(3)
    _, stream = written(voxels, 4)
    rng = np.random.default_rng(0)
    for _ in range(40):
        damaged = stream.copy()
        damaged[rng.integers(len(damaged), size=3)] = rng.integers(0, 256, 3)
        read = code_mixed_octree(start(damaged, True), damaged, fresh_mixtures().octree, voxels[:0], LOW, 4, 500)
        assert len(read.voxels) <= 500 and read.voxels.min(initial=0) >= 0 and read.voxels.max(initial=0) < 16
        assert len(np.unique(read.voxels, axis=0)) == len(read.voxels)


def test_codes_of_whole_numbers_are_those_of_unit_vectors():
    vectors = np.random.default_rng(4).integers(-400, 401, (2000, 3))
    expected = octahedral.encode(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), 15)
    found = np.array([octahedral_code(x, y, z, 15) for x, y, z in vectors.tolist()])
    assert np.abs(found - expected).max() <= 1 and np.mean(found == expected) > 0.99


def test_the_least_axis_is_that_of_the_plain_decomposition():
    rng = np.random.default_rng(5)
    for _ in range(200):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        matrix = axes @ np.diag(rng.uniform(0.5, 1.0, 3) * [0.2, 1.0, 1.0]) @ axes.T * 4e5
        whole = [int(matrix[i, j]) for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]
        found = np.array(least_axis(*whole), dtype=float)
        assert abs(found @ axes[:, 0]) > np.cos(np.radians(2.0)) * np.linalg.norm(found)


def test_the_normal_of_a_plane_of_voxels_is_expected_towards_the_middle_of_the_map():
    side = np.arange(-1, 2)
    floor = np.array([[x, y, 0] for x in side for y in side if (x, y) != (0, 0)] + [[0, 0, 0]], np.int32)
    tilted = floor + np.outer(floor[:, 0], [0, 0, 1]).astype(np.int32)
    for voxels, normal in ((floor, (0, 0, 1)), (tilted, (1, 0, -1)), (floor[:, [2, 0, 1]], (1, 0, 0))):
        told = np.zeros(EXPECTED, np.int64)
        low, codes = np.array([-40, 3, -6]), np.zeros((9, 4), np.int32)
        expect_normal(np.arange(8, dtype=np.int32), 8, 8, voxels, low, np.zeros((9, 3), np.int32), codes, 15, told)
        found = octahedral.decode(told[None, :2], 15)[0]
        assert found @ np.array(normal) / np.linalg.norm(normal) > np.cos(np.radians(6.0))
        assert told[expected_normals.OCCUPIED] == 8 and 1 <= told[expected_normals.FLATNESS] <= 3


def test_a_voxel_alone_is_expected_to_face_the_middle_of_the_map():
    told = np.zeros(EXPECTED, np.int64)
    one, codes = np.zeros((1, 3), np.int32), np.zeros((1, 4), np.int32)
    expect_normal(np.zeros(1, np.int32), 0, 0, one, np.array([30, -10, 5]), one, codes, 15, told)
    view = -np.array([30.5, -9.5, 5.5])
    assert octahedral.decode(told[None, :2], 15)[0] @ view / np.linalg.norm(view) > np.cos(np.radians(6.0))
    assert told[expected_normals.FLATNESS] == 0


def test_the_tables_of_the_guesses_are_the_same_on_every_machine():
    tables = expected_normals._WEIGHTS.astype("<i8").tobytes() + mixed_octree._RANGE.astype("<i8").tobytes()
    assert zlib.crc32(tables) == CRC_OF_TABLES, "what other machines have written could not be read"
