"""The returns that train a neural map, evenly over its neural points (paper III-B 5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import compiled
from revisit.core.kernels.voxel_table import VoxelTable, find_in


@compiled
def choose_returns(
    points: NDArray[np.float32],
    order: NDArray[np.int64],
    positions: NDArray[np.float32],
    table: VoxelTable,
    resolution: float,
    per_point: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Up to `per_point` returns for each neural point, in the given order: rows of `points` and their neural points."""
    taken = np.zeros(len(positions), dtype=np.int32)
    chosen = np.empty(len(positions) * per_point, dtype=np.int64)
    owners = np.empty(len(positions) * per_point, dtype=np.int64)
    slots, following, voxels = table.slots, table.following, table.voxels
    size = 0
    for n in order:
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        vx, vy, vz = int(np.floor(x / resolution)), int(np.floor(y / resolution)), int(np.floor(z / resolution))
        i = find_in(slots, following, voxels, vx, vy, vz)
        if i < 0 or taken[i] >= per_point:
            continue
        gap = 0.0
        for a in range(3):
            gap += (points[n, a] - positions[i, a]) ** 2
        if gap > 3.0 * resolution * resolution:
            continue
        taken[i] += 1
        chosen[size] = n
        owners[size] = i
        size += 1
        if size == len(chosen):
            break
    return chosen[:size], owners[:size]
