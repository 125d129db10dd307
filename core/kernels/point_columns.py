"""Points sorted by the voxel they lie in (x, then y, then z): a search through neighbours reads a few whole pieces."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, loop

MAX_GRID = 1 << 22
"""Most columns of the grid; where the points spread over more, their keys are searched instead."""

_LARGEST_KEY = 2.0**62


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
    cloud = np.ascontiguousarray(positions)
    voxels, bounds = np.empty((len(cloud), 3), dtype=np.int64), np.zeros((2, 3), dtype=np.int64)
    _find_voxels(cloud, resolution, voxels, bounds)
    low, shape = bounds[0], bounds[1] - bounds[0] + 1
    if shape[0] * shape[1] > MAX_GRID or shape[2] > MAX_GRID:
        rows, keys, grid = _sorted(voxels - low, shape)
        return PointColumns(cloud[rows], rows, keys, grid, low[:2], shape[:2])
    grid, levels = np.zeros(shape[0] * shape[1] + 2, dtype=np.int32), np.zeros(shape[2] + 1, dtype=np.int32)
    order, rows, keys = np.empty(len(cloud), np.int32), np.empty(len(cloud), np.int32), np.empty(len(cloud), np.int64)
    points = np.empty_like(cloud)
    _order(cloud, voxels, low, shape[1], levels, grid, order, rows, keys, points)
    return PointColumns(points, rows, keys, grid[:-1], low[:2], shape[:2])


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


@loop
def _find_voxels(
    positions: NDArray[Any], resolution: float, voxels: NDArray[np.int64], bounds: NDArray[np.int64]
) -> None:
    """Fill the voxels (n, 3) of `positions`, and `bounds` (2, 3) with the least and greatest; 0 where there is none."""
    for a in range(3):
        for i in range(np.uint64(len(positions))):
            voxels[i, a] = np.int64(np.floor(positions[i, a] / resolution))
    for a in range(3):
        low, high = (voxels[0, a], voxels[0, a]) if len(voxels) else (0, 0)
        for i in range(np.uint64(len(voxels))):
            low, high = min(low, voxels[i, a]), max(high, voxels[i, a])
        bounds[0, a], bounds[1, a] = low, high


@loop
def _order(
    cloud: NDArray[Any], voxels: NDArray[np.int64], low: NDArray[np.int64], depth: int, levels: NDArray[np.int32],
    grid: NDArray[np.int32], order: NDArray[np.int32], rows: NDArray[np.int32], keys: NDArray[np.int64],
    points: NDArray[Any],
) -> None:  # fmt: skip
    """Fill `grid`, and `rows`, `keys` and `points` in the order of the voxels: by counting heights, then columns.

    `levels` and `grid` are 0, of one and two numbers more than there are; `order` is for its use.
    """
    for i in range(len(cloud)):
        levels[voxels[i, 2] - low[2] + 1] += 1
        grid[(voxels[i, 0] - low[0]) * depth + voxels[i, 1] - low[1] + 2] += 1
    for level in range(1, len(levels)):
        levels[level] += levels[level - 1]
    for cell in range(2, len(grid)):
        grid[cell] += grid[cell - 1]
    for i in range(len(cloud)):
        level = voxels[i, 2] - low[2]
        order[levels[level]] = i
        levels[level] += 1
    for k in range(len(cloud)):  # grid[key + 1] is where the column goes on, and in the end where it ends
        i = order[k]
        key = (voxels[i, 0] - low[0]) * depth + voxels[i, 1] - low[1]
        at = grid[key + 1]
        grid[key + 1] += 1
        rows[at], keys[at] = i, key
        points[at, 0], points[at, 1], points[at, 2] = cloud[i, 0], cloud[i, 1], cloud[i, 2]


@inlined
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
