"""Insertion of returns into elastic neural points, and the spread of the returns around each (paper III-B 3)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.voxel_table import VoxelTable, add, find

POOLED_RETURNS = 8.0


@numba.njit(cache=True)
def insert_returns(
    points: NDArray[np.float32],
    origin: NDArray[np.float32],
    scan: int,
    table: VoxelTable,
    moments: NDArray[np.float64],
    views: NDArray[np.float64],
    scans: NDArray[np.int32],
    size: int,
    resolution: float,
) -> int:
    """Insert returns (n, 3) of one scan, seen from `origin` (3,); returns the new number of neural points.

    A return creates the neural point of its voxel or joins it. Of each neural point: moments (10,) count, sum p and
    the upper sum p p^T; views (3,) sum of the unit vectors towards the sensor; scans (3,) first, last and number of the
    scans that saw it.
    """
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        vx, vy, vz = int(np.floor(x / resolution)), int(np.floor(y / resolution)), int(np.floor(z / resolution))
        i = find(table, vx, vy, vz)
        if i < 0:
            i = size
            size += 1
            add(table, i, vx, vy, vz)
            moments[i] = 0.0
            views[i] = 0.0
            scans[i, 0] = scan
            scans[i, 1] = -1
            scans[i, 2] = 0
        moments[i, 0] += 1.0
        moments[i, 1] += x
        moments[i, 2] += y
        moments[i, 3] += z
        moments[i, 4] += x * x
        moments[i, 5] += x * y
        moments[i, 6] += x * z
        moments[i, 7] += y * y
        moments[i, 8] += y * z
        moments[i, 9] += z * z
        dx, dy, dz = origin[0] - x, origin[1] - y, origin[2] - z
        norm = np.sqrt(dx * dx + dy * dy + dz * dz) + 1e-9
        views[i, 0] += dx / norm
        views[i, 1] += dy / norm
        views[i, 2] += dz / norm
        if scans[i, 1] != scan:
            scans[i, 1] = scan
            scans[i, 2] += 1
    return size


@numba.njit(cache=True)
def pooled_covariances(
    positions: NDArray[np.float32], moments: NDArray[np.float64], table: VoxelTable, resolution: float
) -> NDArray[np.float64]:
    """Covariance (n, 3, 3) of the returns around each point: its 27 voxels, Gaussian in distance.

    A voxel counts at most as POOLED_RETURNS returns, so that dense and sparse scans give the same surface.
    """
    out = np.zeros((len(positions), 3, 3))
    for i in range(len(positions)):
        p = positions[i]
        cx, cy, cz = np.floor(p / resolution).astype(np.int64)
        total = 0.0
        first = np.zeros(3)
        second = np.zeros((3, 3))
        for x in range(cx - 1, cx + 2):
            for y in range(cy - 1, cy + 2):
                for z in range(cz - 1, cz + 2):
                    j = find(table, x, y, z)
                    if j < 0:
                        continue
                    m = moments[j]
                    gap = (positions[j, 0] - p[0]) ** 2 + (positions[j, 1] - p[1]) ** 2 + (positions[j, 2] - p[2]) ** 2
                    if gap > 4.0 * resolution**2:
                        continue
                    w = np.exp(-0.5 * gap / (0.7 * resolution) ** 2) * min(m[0], POOLED_RETURNS) / m[0]
                    total += w * m[0]
                    for a in range(3):
                        first[a] += w * (m[1 + a] - m[0] * p[a])
                    entry = 4
                    for a in range(3):
                        for b in range(a, 3):
                            value = m[entry] - p[a] * m[1 + b] - p[b] * m[1 + a] + m[0] * p[a] * p[b]
                            second[a, b] += w * value
                            entry += 1
        for a in range(3):
            for b in range(a, 3):
                value = second[a, b] / total - first[a] / total * first[b] / total
                out[i, a, b] = value
                out[i, b, a] = value
    return out
