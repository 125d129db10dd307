"""Points sorted by the voxel they lie in (x, then y, then z): a search through neighbours reads a few whole pieces."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

MAX_GRID = 1 << 22
"""Most columns of the grid; where the points spread over more, their keys are searched instead."""

_LARGEST_KEY = 2.0**62
_SHORT = 24
"""Points of a column that are sorted by insertion."""


class PointColumns(NamedTuple):
    """Points in the order of their voxels, and where each column of voxels begins.

    points (n, 3) of the type that was given; rows (n,) int32, their rows before the sorting; keys (n,) int64, x * depth
    + y of their columns counted from `low` (2,), int64; shape (2,) int64, width (x) and depth (y) in columns; grid
    (width * depth + 1,) int32, the first point of each column and of those after it, or empty where there are more than
    MAX_GRID columns.
    """

    points: NDArray[Any]
    rows: NDArray[np.int32]
    keys: NDArray[np.int64]
    grid: NDArray[np.int32]
    low: NDArray[np.int64]
    shape: NDArray[np.int64]


def columns_of(positions: NDArray[np.floating], resolution: float) -> PointColumns:
    """The columns of `positions` (n, 3) over voxels of edge `resolution`; points of one voxel keep their order."""
    voxels, low, high = _voxels(np.ascontiguousarray(positions), resolution)
    shape = high - low + 1
    if shape[0] * shape[1] <= MAX_GRID:
        rows, keys, grid = _counted(voxels, low, shape)
    else:
        rows, keys, grid = _sorted(voxels - low, shape)
    return PointColumns(np.ascontiguousarray(positions)[rows], rows, keys, grid, low[:2], shape[:2])


def _sorted(
    places: NDArray[np.int64], shape: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]]:
    """Rows and keys in the order of the voxels `places` (n, 3), counted from 0; no grid: points far apart."""
    keys = places[:, 0] * shape[1] + places[:, 1]
    if np.prod(shape, dtype=np.float64) < _LARGEST_KEY:
        order = np.argsort(keys * shape[2] + places[:, 2], kind="stable")
    else:
        order = np.lexsort((places[:, 2], keys))
    return order.astype(np.int32), keys[order], np.zeros(0, dtype=np.int32)


@numba.njit(cache=True, error_model="numpy")
def _voxels(
    positions: NDArray[Any], resolution: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """The voxels (n, 3) of `positions`, and the least and greatest of them on each axis; 0 where there is none."""
    voxels = np.empty((len(positions), 3), dtype=np.int64)
    low, high = np.zeros(3, dtype=np.int64), np.zeros(3, dtype=np.int64)
    for a in range(3):
        for i in range(len(positions)):
            voxels[i, a] = np.int64(np.floor(positions[i, a] / resolution))
        if len(positions):
            low[a], high[a] = voxels[:, a].min(), voxels[:, a].max()
    return voxels, low, high


@numba.njit(cache=True, error_model="numpy")
def _counted(
    voxels: NDArray[np.int64], low: NDArray[np.int64], shape: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]]:
    """Rows and keys in the order of the voxels, by counting those of each column, and the grid of the columns."""
    grid = np.zeros(shape[0] * shape[1] + 2, dtype=np.int32)
    keys = np.empty(len(voxels), dtype=np.int64)
    for i in range(len(voxels)):
        keys[i] = (voxels[i, 0] - low[0]) * shape[1] + voxels[i, 1] - low[1]
        grid[keys[i] + 2] += 1
    for cell in range(2, len(grid)):
        grid[cell] += grid[cell - 1]
    rows = np.empty(len(voxels), dtype=np.int32)
    for i in range(len(voxels)):  # grid[key + 1] is where the column goes on, and in the end where it ends
        rows[grid[keys[i] + 1]] = i
        grid[keys[i] + 1] += 1
    heights = np.empty(len(voxels), dtype=np.int64)
    for i in range(len(voxels)):
        heights[i] = voxels[rows[i], 2]
    first = 0
    for i in range(1, len(voxels) + 1):
        if i == len(voxels) or keys[rows[i]] != keys[rows[first]]:
            _order(rows, heights, first, i)
            first = i
    return rows, keys[rows], grid[:-1]


@numba.njit(cache=True, error_model="numpy")
def _order(rows: NDArray[np.int32], heights: NDArray[np.int64], first: int, last: int) -> None:
    """Sort the rows from `first` to before `last` by their heights; equal ones keep their order."""
    if last - first > _SHORT:
        rows[first:last] = rows[first:last][np.argsort(heights[first:last], kind="mergesort")]
        return
    for i in range(first + 1, last):
        row, height, k = rows[i], heights[i], i
        while k > first and heights[k - 1] > height:
            rows[k], heights[k] = rows[k - 1], heights[k - 1]
            k -= 1
        rows[k], heights[k] = row, height


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
