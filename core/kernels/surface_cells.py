"""The voxels around the neural points that a surface can pass, and their corners (paper III-C)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.voxel_table import VoxelTable, add, find

NEAR_PLANE = 0.9


@numba.njit(cache=True)
def enter_cells(
    positions: NDArray[np.float32], normals: NDArray[np.float32], resolution: float, cells: VoxelTable
) -> int:
    """Enter the voxels among the 27 around each of `positions` (n, 3) that its tangent plane comes near.

    Near: the centre lies within 0.9 edges of the plane. `cells` has room for all, 27 n; returns how many there are.
    """
    count = 0
    for i in range(len(positions)):
        home = np.floor(positions[i] / resolution).astype(np.int64)
        for x in range(home[0] - 1, home[0] + 2):
            for y in range(home[1] - 1, home[1] + 2):
                for z in range(home[2] - 1, home[2] + 2):
                    height = ((x + 0.5) * resolution - positions[i, 0]) * normals[i, 0]
                    height += ((y + 0.5) * resolution - positions[i, 1]) * normals[i, 1]
                    height += ((z + 0.5) * resolution - positions[i, 2]) * normals[i, 2]
                    if abs(height) <= NEAR_PLANE * resolution and find(cells, x, y, z) < 0:
                        add(cells, count, x, y, z)
                        count += 1
    return count


@numba.njit(cache=True)
def enter_corners(cells: NDArray[np.int32], corners: VoxelTable) -> tuple[NDArray[np.int32], int]:
    """Enter the eight corners of each of `cells` (m, 3), corner c at + (c & 1, c >> 1 & 1, c >> 2 & 1).

    `corners` has room for all, 8 m. Returns the rows (m, 8) of each cell's corners, and how many corners there are.
    """
    rows = np.empty((len(cells), 8), dtype=np.int32)
    count = 0
    for m in range(len(cells)):
        for c in range(8):
            x, y, z = cells[m, 0] + (c & 1), cells[m, 1] + ((c >> 1) & 1), cells[m, 2] + ((c >> 2) & 1)
            row = find(corners, x, y, z)
            if row < 0:
                row = count
                add(corners, row, x, y, z)
                count += 1
            rows[m, c] = row
    return rows, count
