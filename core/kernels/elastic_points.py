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
    slots, following, voxels = table.slots, table.following, table.voxels
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        vx, vy, vz = int(np.floor(x / resolution)), int(np.floor(y / resolution)), int(np.floor(z / resolution))
        i = find(slots, following, voxels, vx, vy, vz)
        if i < 0:
            i = size
            size += 1
            add(slots, following, voxels, i, vx, vy, vz)
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
    slots, following, voxels = table.slots, table.following, table.voxels
    out = np.empty((len(positions), 3, 3))
    sums = np.empty(10)
    for i in range(len(positions)):
        px, py, pz = positions[i, 0], positions[i, 1], positions[i, 2]
        cx, cy, cz = int(np.floor(px / resolution)), int(np.floor(py / resolution)), int(np.floor(pz / resolution))
        sums[:] = 0.0
        for x in range(cx - 1, cx + 2):
            for y in range(cy - 1, cy + 2):
                for z in range(cz - 1, cz + 2):
                    j = find(slots, following, voxels, x, y, z)
                    if j < 0:
                        continue
                    gap = (positions[j, 0] - px) ** 2 + (positions[j, 1] - py) ** 2 + (positions[j, 2] - pz) ** 2
                    if gap > 4.0 * resolution**2:
                        continue
                    m = moments[j, 0]
                    weight = np.exp(-0.5 * gap / (0.7 * resolution) ** 2) * min(m, POOLED_RETURNS) / m
                    _pool(sums, moments, j, weight, px, py, pz)
        _covariance(sums, out, i)
    return out


@numba.njit(inline="always")
def _pool(
    sums: NDArray[np.float64], moments: NDArray[np.float64], j: int, weight: float, px: float, py: float, pz: float
) -> None:
    """Add the moments of point `j` about (px, py, pz), times `weight`, to `sums` (10,): count, p, upper p p^T."""
    n, x, y, z = moments[j, 0], moments[j, 1], moments[j, 2], moments[j, 3]
    sums[0] += weight * n
    sums[1] += weight * (x - n * px)
    sums[2] += weight * (y - n * py)
    sums[3] += weight * (z - n * pz)
    sums[4] += weight * (moments[j, 4] - px * x - px * x + n * px * px)
    sums[5] += weight * (moments[j, 5] - px * y - py * x + n * px * py)
    sums[6] += weight * (moments[j, 6] - px * z - pz * x + n * px * pz)
    sums[7] += weight * (moments[j, 7] - py * y - py * y + n * py * py)
    sums[8] += weight * (moments[j, 8] - py * z - pz * y + n * py * pz)
    sums[9] += weight * (moments[j, 9] - pz * z - pz * z + n * pz * pz)


@numba.njit(inline="always")
def _covariance(sums: NDArray[np.float64], out: NDArray[np.float64], i: int) -> None:
    """The covariance of pooled `sums` into out[i]."""
    x, y, z = sums[1] / sums[0], sums[2] / sums[0], sums[3] / sums[0]
    out[i, 0, 0] = sums[4] / sums[0] - x * x
    out[i, 0, 1] = out[i, 1, 0] = sums[5] / sums[0] - x * y
    out[i, 0, 2] = out[i, 2, 0] = sums[6] / sums[0] - x * z
    out[i, 1, 1] = sums[7] / sums[0] - y * y
    out[i, 1, 2] = out[i, 2, 1] = sums[8] / sums[0] - y * z
    out[i, 2, 2] = sums[9] / sums[0] - z * z
