"""Voxel hash of neural points: one slot a voxel, direct-mapped, bounded (paper III-B 3).

Voxels of one column (x, y) lie side by side in the table, so that neighbour searches touch few cache lines.
The kernels are compiled by numba; arrays are float32 metres, indices int32, -1 means none.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

TABLE_BITS = 20
_MASK = (1 << TABLE_BITS) - 1


@numba.njit(inline="always")
def slot_of(x: int, y: int, z: int) -> int:
    """The table slot of voxel (x, y, z)."""
    column = (x & 0xFFFFF) * 0x9E3779B1 + (y & 0xFFFFF) * 0x85EBCA77
    column = (column ^ (column >> 15)) * 0x2C1B3C6D & 0x7FFFFFFF
    column = (column ^ (column >> 12)) * 0x297A2D39 & 0x7FFFFFFF
    return ((column ^ (column >> 15)) + z) & _MASK


@numba.njit(cache=True)
def build_table(positions: NDArray[np.float32], resolution: float) -> NDArray[np.int32]:
    """The slots (2^20,) int32 that hold the indices of `positions` (n, 3)."""
    slots = np.full(1 << TABLE_BITS, -1, dtype=np.int32)
    for i in range(len(positions)):
        x = int(np.floor(positions[i, 0] / resolution))
        y = int(np.floor(positions[i, 1] / resolution))
        z = int(np.floor(positions[i, 2] / resolution))
        slots[slot_of(x, y, z)] = i
    return slots


@numba.njit(cache=True)
def nearest(
    queries: NDArray[np.float32],
    positions: NDArray[np.float32],
    slots: NDArray[np.int32],
    resolution: float,
    count: int,
    rings: int,
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The `count` nearest neural points among the voxels within `rings` of each query (m, 3).

    Returns indices (m, count) int32, -1 where fewer exist, and squared distances (m, count) float32, inf there.
    Complete for points nearer than `rings` voxel edges.
    """
    indices = np.full((len(queries), count), -1, dtype=np.int32)
    squared = np.full((len(queries), count), np.inf, dtype=np.float32)
    reach = np.float32((rings * resolution) ** 2)
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
                first = slot_of(x, y, cz - rings)
                for step in range(2 * rings + 1):
                    i = slots[(first + step) & _MASK]
                    if i < 0:
                        continue
                    d = (positions[i, 0] - px) ** 2 + (positions[i, 1] - py) ** 2 + (positions[i, 2] - pz) ** 2
                    if d >= worst:
                        continue
                    k = count - 1
                    while k > 0 and squared[q, k - 1] > d:
                        squared[q, k] = squared[q, k - 1]
                        indices[q, k] = indices[q, k - 1]
                        k -= 1
                    squared[q, k] = d
                    indices[q, k] = i
                    worst = min(reach, squared[q, count - 1])
    return indices, squared
