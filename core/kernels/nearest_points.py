"""The nearest points around queries, among points sorted by their columns of voxels (paper III-B 2)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.point_columns import PointColumns, span


@numba.njit(cache=True)
def nearest_points(
    queries: NDArray[np.float32], columns: PointColumns, resolution: float, count: int, rings: int
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The `count` nearest points among the columns within `rings` voxels of each query (m, 3), nearest first.

    Returns rows (m, count) int32 of the points before they were sorted, -1 where fewer are nearer than `rings` voxel
    edges, and squared distances (m, count) float32, inf there. Of points equally far the one of the lower voxel counts.
    """
    points, rows, keys, grid = columns.points, columns.rows, columns.keys, columns.grid
    x_low, y_low, width, depth = columns.low[0], columns.low[1], columns.shape[0], columns.shape[1]
    reach = np.float32((rings * resolution) ** 2)
    found = np.full((len(queries), count), -1, dtype=np.int32)
    squared = np.full((len(queries), count), reach, dtype=np.float32)
    for q in range(len(queries)):
        px, py, pz = queries[q, 0], queries[q, 1], queries[q, 2]
        cx, cy = int(np.floor(px / resolution)), int(np.floor(py / resolution)) - y_low
        farthest = reach
        for step in range(2 * rings + 1):
            x = cx + (step + 1) // 2 * (1 - 2 * (step & 1))  # from the middle outwards
            gap = max(x * resolution - px, px - (x + 1) * resolution, 0.0)
            if gap * gap > farthest:
                continue
            first, last = span(keys, grid, width, depth, x - x_low, cy - rings, cy + rings)
            for i in range(first, last):
                dx, dy, dz = points[i, 0] - px, points[i, 1] - py, points[i, 2] - pz
                d = dx * dx + dy * dy + dz * dz
                if d > farthest or (d == farthest and i > found[q, count - 1]):
                    continue
                k = count - 1
                while k > 0 and (squared[q, k - 1] > d or (squared[q, k - 1] == d and found[q, k - 1] > i)):
                    squared[q, k], found[q, k] = squared[q, k - 1], found[q, k - 1]
                    k -= 1
                squared[q, k], found[q, k] = d, i
                farthest = squared[q, count - 1]
        for k in range(count):
            if found[q, k] < 0:
                squared[q, k] = np.inf
            else:
                found[q, k] = rows[found[q, k]]
    return found, squared
