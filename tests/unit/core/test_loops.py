"""Loops are compiled without the counting of references (docs/decisions/0111)."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from revisit.core.kernels import cluster_joins, elastic_points, nearest_points, octree_coder, oriented_normals
from revisit.core.kernels.loops import loop
from revisit.core.kernels.visibility import _nearest_around

HOT = (
    nearest_points._find_nearest, nearest_points._find_any, elastic_points._insert, elastic_points._pool,
    oriented_normals._orient, cluster_joins._join, octree_coder._code_level,
)  # fmt: skip


def test_the_hot_loops_count_no_references():
    assert all(one.targetoptions["_nrt"] is False for one in HOT)


def test_a_loop_that_makes_an_array_is_refused_by_the_compiler():
    @loop
    def doubled(numbers):
        return 2.0 * numbers

    with pytest.raises(numba.core.errors.NumbaError):
        doubled(np.ones(3))


def test_the_nearest_range_around_a_pixel_is_that_of_nine_and_zero_where_fewer_than_two_are_measured():
    rng = np.random.default_rng(0)
    image = np.where(rng.random((180, 360)) < 0.2, rng.uniform(1, 50, (180, 360)), np.inf).astype(np.float32)
    around = np.pad(np.pad(image, ((0, 0), (1, 1)), mode="wrap"), ((1, 1), (0, 0)), constant_values=np.inf)
    nine = np.stack([around[i : i + 180, j : j + 360] for i in range(3) for j in range(3)])
    expected = np.where(np.isfinite(nine).sum(axis=0) >= 2, nine.min(axis=0), 0.0)
    assert np.array_equal(_nearest_around(image), expected.ravel())
