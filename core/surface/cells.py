"""The voxels around the neural points that a surface can pass, and their corners."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

_NEAR_PLANE = 0.9


@numba.njit(cache=True)
def cells_near_planes(
    positions: Array, normals: Array, resolution: float, first: NDArray[np.int64], shape: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Voxels among the 27 around each neural point whose centre is within 0.9 edges of its tangent plane.

    `first` and `shape` (3,) bound all of them. Returns cells (m, 3) voxel indices, their corners (m, 8) as rows of the
    third array, and corners (n, 3) voxel indices.
    """
    taken = np.zeros((shape[0], shape[1], shape[2]), dtype=np.bool_)
    cells = np.empty((27 * len(positions), 3), dtype=np.int32)
    count = 0
    for i in range(len(positions)):
        home = np.floor(positions[i] / resolution).astype(np.int64) - first
        for x in range(home[0] - 1, home[0] + 2):
            for y in range(home[1] - 1, home[1] + 2):
                for z in range(home[2] - 1, home[2] + 2):
                    if taken[x, y, z]:
                        continue
                    height = ((x + first[0] + 0.5) * resolution - positions[i, 0]) * normals[i, 0]
                    height += ((y + first[1] + 0.5) * resolution - positions[i, 1]) * normals[i, 1]
                    height += ((z + first[2] + 0.5) * resolution - positions[i, 2]) * normals[i, 2]
                    if abs(height) <= _NEAR_PLANE * resolution:
                        taken[x, y, z] = True
                        cells[count, 0], cells[count, 1], cells[count, 2] = x, y, z
                        count += 1
    cells = cells[:count].copy()
    row_of = np.full((shape[0] + 1, shape[1] + 1, shape[2] + 1), -1, dtype=np.int32)
    corners = np.empty((8 * count, 3), dtype=np.int32)
    cell_corners = np.empty((count, 8), dtype=np.int32)
    rows = 0
    for m in range(count):
        for c in range(8):
            x, y, z = cells[m, 0] + (c & 1), cells[m, 1] + ((c >> 1) & 1), cells[m, 2] + ((c >> 2) & 1)
            if row_of[x, y, z] < 0:
                row_of[x, y, z] = rows
                corners[rows, 0], corners[rows, 1], corners[rows, 2] = x, y, z
                rows += 1
            cell_corners[m, c] = row_of[x, y, z]
    corners = corners[:rows].copy()
    for a in range(3):
        cells[:, a] += np.int32(first[a])
        corners[:, a] += np.int32(first[a])
    return cells, cell_corners, corners
