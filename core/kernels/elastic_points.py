"""Insertion of returns into elastic neural points, and the spread of the returns around each (paper III-B 3)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.point_columns import PointColumns, span
from revisit.core.kernels.voxel_table import VoxelTable, add_to, find_in

POOLED_RETURNS = 8.0

MOMENTS, VIEW = slice(0, 10), slice(10, 13)
FIRST_SCAN, LAST_SCAN, SCANS = 13, 14, 15
RECORD = 16
"""Numbers that are gathered of a neural point, in two lines of the cache."""

_CHUNK = 1024
_TINY_M = np.float32(1e-9)


@numba.njit(cache=True, error_model="numpy")
def insert_returns(
    points: NDArray[np.float32],
    start: int,
    origin: NDArray[np.float32],
    scan: int,
    table: VoxelTable,
    records: NDArray[np.float64],
    size: int,
    resolution: float,
    limit: int,
) -> tuple[int, int]:
    """Insert returns (n, 3) of one scan from row `start` on, seen from `origin` (3,), into the first `size` records.

    Returns the new number of neural points, and the row to go on from with more records where there was no room.
    A return creates the neural point of its voxel or joins it. A record (RECORD,) is count, sum p and the upper sum
    p p^T; the sum of the unit vectors towards the sensor; and the first, the last and the number of the scans that saw
    it. Where there are `limit` of them, no more are created: the returns are left out.
    """
    slots, following, voxels = table.slots, table.following, table.voxels
    cells, units = np.empty((3, _CHUNK), dtype=np.int32), np.empty((3, _CHUNK), dtype=np.float32)
    while start < len(points):
        count = min(_CHUNK, len(points) - start)
        if size + count > len(records) and len(records) < limit:
            break
        _prepare(points, start, count, origin, resolution, cells, units)
        k = 0
        while k < count:
            x, y, z = cells[0, k], cells[1, k], cells[2, k]
            i = find_in(slots, following, voxels, x, y, z)
            first = k
            while k < count and cells[0, k] == x and cells[1, k] == y and cells[2, k] == z:
                k += 1
            if i < 0 and size >= limit:
                continue
            if i < 0:
                i = size
                size += 1
                add_to(slots, following, voxels, i, x, y, z)
                records[i] = 0.0
                records[i, FIRST_SCAN], records[i, LAST_SCAN] = scan, -1.0
            if records[i, LAST_SCAN] != scan:
                records[i, LAST_SCAN] = scan
                records[i, SCANS] += 1.0
            _gather(points, start, first, k, units, records, i)
        start += count
    return size, start


@numba.njit(inline="always")
def _prepare(
    points: NDArray[np.float32], start: int, count: int, origin: NDArray[np.float32], resolution: float,
    cells: NDArray[np.int32], units: NDArray[np.float32],
) -> None:  # fmt: skip
    """Voxels and unit vectors towards `origin` of `count` returns from row `start` on, many at once."""
    ox, oy, oz = origin[0], origin[1], origin[2]
    for a in range(3):
        for k in range(count):
            units[a, k] = points[start + k, a]
        for k in range(count):
            cells[a, k] = np.int32(np.floor(np.float64(units[a, k]) / resolution))
    for k in range(count):
        dx, dy, dz = ox - units[0, k], oy - units[1, k], oz - units[2, k]
        inverse = np.float32(1.0) / (np.sqrt(dx * dx + dy * dy + dz * dz) + _TINY_M)
        units[0, k], units[1, k], units[2, k] = dx * inverse, dy * inverse, dz * inverse


@numba.njit(inline="always")
def _gather(
    points: NDArray[np.float32], start: int, first: int, last: int, units: NDArray[np.float32],
    records: NDArray[np.float64], i: int,
) -> None:  # fmt: skip
    """Add the returns from start + first up to start + last, all in one voxel, to record i."""
    sx, sy, sz, xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    ux, uy, uz = 0.0, 0.0, 0.0
    for k in range(first, last):
        x, y, z = points[start + k, 0], points[start + k, 1], points[start + k, 2]
        sx, sy, sz = sx + x, sy + y, sz + z
        xx, xy, xz = xx + x * x, xy + x * y, xz + x * z
        yy, yz, zz = yy + y * y, yz + y * z, zz + z * z
        ux, uy, uz = ux + units[0, k], uy + units[1, k], uz + units[2, k]
    sums = float(last - first), sx, sy, sz, xx, xy, xz, yy, yz, zz, ux, uy, uz
    for a in range(13):
        records[i, a] += sums[a]


@numba.njit(cache=True, error_model="numpy")
def pooled_covariances(
    positions: NDArray[np.float32], records: NDArray[np.float64], columns: PointColumns, resolution: float
) -> NDArray[np.float64]:
    """Covariance (m, 3, 3) of the returns around each of `positions` (m, 3): its 27 voxels, Gaussian in distance.

    `columns` are those of the neural points that the `records` belong to. A voxel counts at most as POOLED_RETURNS
    returns, so that dense and sparse scans give the same surface.
    """
    points, rows, keys, grid = columns.points, columns.rows, columns.keys, columns.grid
    x_low, y_low, width, depth = columns.low[0], columns.low[1], columns.shape[0], columns.shape[1]
    out = np.empty((len(positions), 3, 3))
    sums = np.empty(10)
    for i in range(len(positions)):
        px, py, pz = positions[i, 0], positions[i, 1], positions[i, 2]
        cx, cy, cz = int(np.floor(px / resolution)), int(np.floor(py / resolution)), int(np.floor(pz / resolution))
        sums[:] = 0.0
        for x in range(cx - 1 - x_low, cx + 2 - x_low):
            first, last = span(keys, grid, width, depth, x, cy - 1 - y_low, cy + 1 - y_low)
            for k in range(first, last):
                gap = (points[k, 0] - px) ** 2 + (points[k, 1] - py) ** 2 + (points[k, 2] - pz) ** 2
                if gap > 4.0 * resolution**2 or abs(int(np.floor(points[k, 2] / resolution)) - cz) > 1:
                    continue
                j = rows[k]
                m = records[j, 0]
                weight = np.exp(-0.5 * gap / (0.7 * resolution) ** 2) * min(m, POOLED_RETURNS) / m
                _pool(sums, records, j, weight, px, py, pz)
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
