"""The nearest points around queries, through a voxel table (paper III-B 2)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.voxel_table import VoxelTable, slot_of


@numba.njit(cache=True)
def nearest_points(
    queries: NDArray[np.float32],
    positions: NDArray[np.float32],
    table: VoxelTable,
    resolution: float,
    count: int,
    rings: int,
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The `count` nearest of `positions` (n, 3) among the voxels within `rings` of each query (m, 3).

    Returns indices (m, count) int32, -1 where fewer exist, and squared distances (m, count) float32, inf there.
    Complete for points nearer than `rings` voxel edges.
    """
    indices = np.full((len(queries), count), -1, dtype=np.int32)
    squared = np.full((len(queries), count), np.inf, dtype=np.float32)
    reach = np.float32((rings * resolution) ** 2)
    mask = len(table.slots) - 1
    for q in range(len(queries)):
        px, py, pz = queries[q, 0], queries[q, 1], queries[q, 2]
        cx, cy, cz = int(np.floor(px / resolution)), int(np.floor(py / resolution)), int(np.floor(pz / resolution))
        worst = reach
        for x in range(cx - rings, cx + rings + 1):
            dx = max(x * resolution - px, px - (x + 1) * resolution, 0.0)
            for y in range(cy - rings, cy + rings + 1):
                dy = max(y * resolution - py, py - (y + 1) * resolution, 0.0)
                if dx * dx + dy * dy > worst:
                    continue
                first = slot_of(table.slots, x, y, cz - rings)
                for step in range(2 * rings + 1):
                    i = table.slots[(first + step) & mask]
                    while i >= 0:
                        d = (positions[i, 0] - px) ** 2 + (positions[i, 1] - py) ** 2 + (positions[i, 2] - pz) ** 2
                        # another column may share these slots
                        if d < worst and table.voxels[i, 0] == x and table.voxels[i, 1] == y:
                            k = count - 1
                            while k > 0 and squared[q, k - 1] > d:
                                squared[q, k] = squared[q, k - 1]
                                indices[q, k] = indices[q, k - 1]
                                k -= 1
                            squared[q, k] = d
                            indices[q, k] = i
                            worst = min(reach, squared[q, count - 1])
                        i = table.following[i]
    return indices, squared
