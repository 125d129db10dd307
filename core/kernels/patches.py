"""Surface points with their normals, each in one record of half a cache line, sorted for searches in vertical columns.

A search takes all points of the columns around without asking whether a column can still hold a nearer one: a step
that a processor guesses wrong costs more than the few distances it saves.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.point_columns import columns_of, span

Array64 = NDArray[np.float64]
Records = NDArray[np.float32]


class Patches(NamedTuple):
    """Small planes of a surface in the order of their columns.

    records (n, 8) float32: position, 0, unit normal, 0; rows (n,) int32, those before the sorting; keys, grid, low and
    shape as in `PointColumns`.
    """

    records: Records
    rows: NDArray[np.int32]
    keys: NDArray[np.int64]
    grid: NDArray[np.int32]
    low: NDArray[np.int64]
    shape: NDArray[np.int64]


def patches_of(points: Array64, normals: Array64, edge: float) -> Patches:
    """The patches of `points` (n, 3) with unit `normals` (n, 3), in columns of `edge` metres."""
    columns = columns_of(points, edge)
    records = np.zeros((len(points), 8), dtype=np.float32)
    records[:, :3], records[:, 4:7] = columns.points, normals[columns.rows]
    return Patches(records, columns.rows, columns.keys, columns.grid, columns.low, columns.shape)


@numba.njit(inline="always")
def nearest_patch(
    records: Records, keys: NDArray[np.int64], grid: NDArray[np.int32], x_low: int, y_low: int, width: int, depth: int,
    edge: float, reach: float, px: float, py: float, pz: float,
) -> int:  # fmt: skip
    """The sorted row of the patch nearest to (px, py, pz) and nearer than `reach`, or -1."""
    qx, qy, qz, inverse = np.float32(px), np.float32(py), np.float32(pz), np.float32(1.0 / edge)
    nearest, least, rings = -1, np.float32(reach * reach), int(np.ceil(reach / edge))
    x, y = int(np.floor(qx * inverse)) - x_low, int(np.floor(qy * inverse)) - y_low
    y_first, y_end = max(y - rings, 0), min(y + rings, depth - 1) + 1
    if y_first >= y_end:
        return -1
    for column in range(max(x - rings, 0), min(x + rings, width - 1) + 1):
        for i in range(*_between(keys, grid, column * depth + y_first, column * depth + y_end)):
            dx, dy, dz = records[i, 0] - qx, records[i, 1] - qy, records[i, 2] - qz
            squared = dx * dx + dy * dy + dz * dz
            nearest = i if squared < least else nearest
            least = min(least, squared)
    return nearest


@numba.njit(inline="always")
def two_nearest(
    records: Records, keys: NDArray[np.int64], grid: NDArray[np.int32], x_low: int, y_low: int, width: int, depth: int,
    edge: float, reach: float, px: float, py: float, pz: float,
) -> tuple[int, float, float]:  # fmt: skip
    """The sorted row of the patch nearest to (px, py, pz), or -1, and the distances of it and of the next one.

    Both are at most `reach`, and `reach` where there is none. The columns next to the point are looked through first,
    those farther away only where they can hold one of the two.
    """
    qx, qy, qz = np.float32(px), np.float32(py), np.float32(pz)
    nearest, least = -1, np.float32(reach * reach)
    next_least = least
    x_home, y_home = int(np.floor(px / edge)), int(np.floor(py / edge))
    aside = min(px - x_home * edge, py - y_home * edge)
    aside = edge + min(aside, min((x_home + 1) * edge - px, (y_home + 1) * edge - py))
    rings = 1
    for turn in range(2):  # the nine columns around, then those around them
        for x in range(x_home - rings, x_home + rings + 1):
            inside = turn == 1 and abs(x - x_home) <= 1
            for part in range(2 if inside else 1):
                y_first, y_last = y_home - rings, y_home + rings
                if inside:
                    y_first, y_last = (y_first, y_home - 2) if part == 0 else (y_home + 2, y_last)
                first, last = span(keys, grid, width, depth, x - x_low, y_first - y_low, y_last - y_low)
                for i in range(first, last):
                    dx, dy, dz = records[i, 0] - qx, records[i, 1] - qy, records[i, 2] - qz
                    squared = dx * dx + dy * dy + dz * dz
                    next_least = min(next_least, max(least, squared))
                    nearest = i if squared < least else nearest
                    least = min(least, squared)
        if next_least <= aside * aside or turn == 1:
            break
        rings = int(np.ceil(np.sqrt(next_least) / edge))
    return nearest, float(np.sqrt(least)), float(np.sqrt(next_least))


@numba.njit(inline="always")
def _between(keys: NDArray[np.int64], grid: NDArray[np.int32], begin: int, end: int) -> tuple[int, int]:
    """The points of the columns from `begin` to before `end`: a first row, and one past the last."""
    if len(grid):
        return grid[begin], grid[end]
    return int(np.searchsorted(keys, begin)), int(np.searchsorted(keys, end))
