"""The voxels around the neural points that a surface can pass, and their corners (paper III-C)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.voxel_table import VoxelTable, add, find

NEAR_PLANE = 0.9


@numba.njit(cache=True)
def enter_observed_corners(positions: NDArray[np.float32], resolution: float, reach: float, corners: VoxelTable) -> int:
    """Enter the voxel corners within `reach` metres of any of `positions` (n, 3); returns how many there are.

    Corner (x, y, z) lies at (x, y, z) * resolution. `corners` has room for all, (2 ceil(reach / resolution))^3 n.
    """
    slots, following, voxels = corners.slots, corners.following, corners.voxels
    count, steps = 0, int(np.ceil(reach / resolution))
    limit = np.float32(reach)
    for i in range(len(positions)):
        px, py, pz = positions[i, 0], positions[i, 1], positions[i, 2]
        vx, vy, vz = int(np.floor(px / resolution)), int(np.floor(py / resolution)), int(np.floor(pz / resolution))
        for x in range(vx - steps + 1, vx + steps + 1):
            dx = px - np.float32(x * resolution)
            for y in range(vy - steps + 1, vy + steps + 1):
                dy = py - np.float32(y * resolution)
                for z in range(vz - steps + 1, vz + steps + 1):
                    dz = pz - np.float32(z * resolution)
                    if np.sqrt(dx * dx + dy * dy + dz * dz) > limit or find(slots, following, voxels, x, y, z) >= 0:
                        continue
                    add(slots, following, voxels, count, x, y, z)
                    count += 1
    return count


@numba.njit(cache=True)
def enter_cells(
    positions: NDArray[np.float32],
    normals: NDArray[np.float32],
    resolution: float,
    corners: VoxelTable,
    cells: VoxelTable,
) -> tuple[NDArray[np.int32], int]:
    """Enter the voxels among the 27 around each of `positions` (n, 3) that its tangent plane comes near.

    Near: the centre lies within 0.9 edges of the plane. Voxels without all eight corners in `corners` are left out.
    `cells` has room for all, 27 n. Returns the rows (room, 8) of each cell's corners, corner c at + (c & 1, c >> 1 & 1,
    c >> 2 & 1), and how many cells there are.
    """
    slots, following, voxels = cells.slots, cells.following, cells.voxels
    corner_slots, corner_following, corner_voxels = corners.slots, corners.following, corners.voxels
    rows = np.empty((len(voxels), 8), dtype=np.int32)
    count, reach = 0, NEAR_PLANE * resolution
    for i in range(len(positions)):
        vx, vy = int(np.floor(positions[i, 0] / resolution)), int(np.floor(positions[i, 1] / resolution))
        vz = int(np.floor(positions[i, 2] / resolution))
        for x in range(vx - 1, vx + 2):
            for y in range(vy - 1, vy + 2):
                for z in range(vz - 1, vz + 2):
                    height = ((x + 0.5) * resolution - positions[i, 0]) * normals[i, 0]
                    height += ((y + 0.5) * resolution - positions[i, 1]) * normals[i, 1]
                    height += ((z + 0.5) * resolution - positions[i, 2]) * normals[i, 2]
                    if abs(height) > reach or find(slots, following, voxels, x, y, z) >= 0:
                        continue
                    known = 0
                    while known < 8:
                        step = known & 1, (known >> 1) & 1, (known >> 2) & 1
                        row = find(corner_slots, corner_following, corner_voxels, x + step[0], y + step[1], z + step[2])
                        if row < 0:
                            break
                        rows[count, known] = row
                        known += 1
                    if known == 8:
                        add(slots, following, voxels, count, x, y, z)
                        count += 1
    return rows, count
