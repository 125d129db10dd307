"""Joins the cells of points that lie near each other: the inner loop of Euclidean clustering (paper III-C)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.voxel_table import VoxelTable, find


@numba.njit(cache=True)
def join_cells(
    points: NDArray[np.float32], starts: NDArray[np.int64], cells: VoxelTable, radius: float
) -> NDArray[np.int64]:
    """The root cell (c,), the first of its part, of each cell: cells with points nearer than `radius` are joined.

    `points` are grouped by cell: those of cell i are the rows starts[i] to starts[i + 1]. A cell's edge is
    radius / sqrt(3), so that its own points are near each other and those more than two cells away are not.
    """
    slots, following, voxels = cells.slots, cells.following, cells.voxels
    parent = np.arange(len(voxels))
    limit = radius * radius
    for cell in range(len(voxels)):
        x, y, z = voxels[cell, 0], voxels[cell, 1], voxels[cell, 2]
        for dx in range(3):
            for dy in range(-2, 3):
                for dz in range(-2, 3):
                    if (dx, dy, dz) <= (0, 0, 0):
                        continue
                    other = find(slots, following, voxels, x + dx, y + dy, z + dz)
                    if other < 0:
                        continue
                    a, b = _root(parent, cell), _root(parent, other)
                    if a != b and _touch(points, starts, cell, other, limit):
                        parent[max(a, b)] = min(a, b)
    for cell in range(len(parent)):
        parent[cell] = _root(parent, cell)
    return parent


@numba.njit(cache=True)
def _root(parent: NDArray[np.int64], cell: int) -> int:
    while parent[cell] != cell:
        parent[cell] = parent[parent[cell]]
        cell = parent[cell]
    return cell


@numba.njit(cache=True)
def _touch(points: NDArray[np.float32], starts: NDArray[np.int64], a: int, b: int, limit: float) -> bool:
    for i in range(starts[a], starts[a + 1]):
        for j in range(starts[b], starts[b + 1]):
            gap = 0.0
            for k in range(3):
                gap += (points[i, k] - points[j, k]) ** 2
            if gap < limit:
                return True
    return False
