"""The voxels around the neural points that a surface can pass, and their corners (paper III-C)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.voxel_table import VoxelTable, add, find

NEAR_PLANE = 0.9


@numba.njit(cache=True, error_model="numpy")
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


@numba.njit(cache=True, error_model="numpy")
def find_cells(
    positions: NDArray[np.float32], normals: NDArray[np.float32], resolution: float, corners: VoxelTable, count: int
) -> NDArray[np.int32]:
    """The voxels among the 27 around each of `positions` (n, 3) that its tangent plane comes near, in this order.

    Near: the centre lies within 0.9 edges of the plane. Voxels without all eight corners among the `count` of `corners`
    are left out. Returns the rows (m, 8) of each voxel's corners, corner c at + (c & 1, c >> 1 & 1, c >> 2 & 1).
    """
    slots, following, voxels = corners.slots, corners.following, corners.voxels
    rows = np.empty((count, 8), dtype=np.int32)
    tried = np.zeros(count, dtype=np.bool_)  # a voxel is named by its lowest corner
    found, reach = 0, NEAR_PLANE * resolution
    for i in range(len(positions)):
        px, py, pz = positions[i, 0], positions[i, 1], positions[i, 2]
        vx, vy, vz = int(np.floor(px / resolution)), int(np.floor(py / resolution)), int(np.floor(pz / resolution))
        for x in range(vx - 1, vx + 2):
            for y in range(vy - 1, vy + 2):
                for z in range(vz - 1, vz + 2):
                    height = ((x + 0.5) * resolution - px) * normals[i, 0]
                    height += ((y + 0.5) * resolution - py) * normals[i, 1]
                    height += ((z + 0.5) * resolution - pz) * normals[i, 2]
                    if abs(height) > reach:
                        continue
                    row = find(slots, following, voxels, x, y, z)
                    if row < 0 or tried[row]:
                        continue
                    tried[row] = True
                    known = 0
                    while known < 8 and row >= 0:
                        rows[found, known] = row
                        known += 1
                        step = known & 1, (known >> 1) & 1, (known >> 2) & 1
                        if known < 8:
                            row = find(slots, following, voxels, x + step[0], y + step[1], z + step[2])
                    found += known == 8
    return rows[:found].copy()
