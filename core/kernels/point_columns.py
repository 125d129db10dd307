"""Points sorted by the voxel they lie in (x, then y, then z): a search through neighbours reads a few whole pieces."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.voxel_table import voxels_of

MAX_GRID = 1 << 22
"""Most columns of the grid; where the points spread over more, their keys are searched instead."""

_LARGEST_KEY = 2.0**62


class PointColumns(NamedTuple):
    """Points in the order of their voxels, and where each column of voxels begins.

    points (n, 3) float32; rows (n,) int32, their rows before the sorting; keys (n,) int64, x * depth + y of their
    columns counted from `low` (2,), int64; shape (2,) int64, width (x) and depth (y) in columns; grid
    (width * depth + 1,) int32, the first point of each column and of those after it, or empty where there are more than
    MAX_GRID columns.
    """

    points: NDArray[np.float32]
    rows: NDArray[np.int32]
    keys: NDArray[np.int64]
    grid: NDArray[np.int32]
    low: NDArray[np.int64]
    shape: NDArray[np.int64]


def columns_of(positions: NDArray[np.float32], resolution: float) -> PointColumns:
    """The columns of `positions` (n, 3) over voxels of edge `resolution`."""
    voxels = voxels_of(positions, resolution).astype(np.int64) if len(positions) else np.zeros((1, 3), np.int64)
    low = voxels.min(axis=0)
    shape = voxels.max(axis=0) - low + 1
    places = (voxels - low)[: len(positions)]
    keys = places[:, 0] * shape[1] + places[:, 1]
    if np.prod(shape, dtype=np.float64) < _LARGEST_KEY:
        order = np.argsort(keys * shape[2] + places[:, 2])
    else:
        order = np.lexsort((places[:, 2], keys))
    keys = keys[order]
    points = np.ascontiguousarray(positions[order])
    return PointColumns(points, order.astype(np.int32), keys, _grid(keys, shape[:2]), low[:2], shape[:2])


def _grid(keys: NDArray[np.int64], shape: NDArray[np.int64]) -> NDArray[np.int32]:
    cells = int(shape[0]) * int(shape[1])
    if cells > MAX_GRID:
        return np.zeros(0, dtype=np.int32)
    grid = np.zeros(cells + 1, dtype=np.int32)
    np.cumsum(np.bincount(keys, minlength=cells), out=grid[1:])
    return grid


@numba.njit(inline="always")
def span(
    keys: NDArray[np.int64], grid: NDArray[np.int32], width: int, depth: int, x: int, y_first: int, y_last: int
) -> tuple[int, int]:
    """The points of the columns (x, y_first) to (x, y_last), counted from `low`: a first row, and one past the last.

    Takes the arrays of the columns one by one: a loop that takes them out of a tuple counts references at every step.
    """
    first, last = max(y_first, 0), min(y_last, depth - 1)
    if x < 0 or x >= width or first > last:
        return 0, 0
    begin, end = x * depth + first, x * depth + last + 1
    if len(grid):
        return grid[begin], grid[end]
    return int(np.searchsorted(keys, begin)), int(np.searchsorted(keys, end))
