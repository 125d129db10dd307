"""Insertion of returns into elastic neural points, and the spread of the returns around each (paper III-B 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, loop
from revisit.core.kernels.point_columns import PointColumns, span
from revisit.core.kernels.voxel_table import VoxelTable, add_to, find_in

Rows = NDArray[np.int64]

POOLED_RETURNS = 8.0

MOMENTS, VIEW = slice(0, 10), slice(10, 13)
FIRST_SCAN, LAST_SCAN, SCANS = 13, 14, 15
RECORD = 16
"""Numbers that are gathered of a neural point, in two lines of the cache."""

_CHUNK = 512
_TINY_M = np.float32(1e-9)
_SPREAD = 6  # numbers of an upper d d^T


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
    cells, units = np.empty((3, _CHUNK), dtype=np.int32), np.empty((3, _CHUNK), dtype=np.float32)
    runs, rows = np.empty(_CHUNK + 1, dtype=np.int64), np.empty(_CHUNK, dtype=np.int64)
    return _insert(points, start, origin, scan, table, records, size, resolution, limit, cells, units, runs, rows)


@loop
def _insert(
    points: NDArray[np.float32], start: int, origin: NDArray[np.float32], scan: int, table: VoxelTable,
    records: NDArray[np.float64], size: int, resolution: float, limit: int, cells: NDArray[np.int32],
    units: NDArray[np.float32], runs: Rows, rows: Rows,
) -> tuple[int, int]:  # fmt: skip
    """As `insert_returns`; `cells` and `units` (3, _CHUNK), `runs` and `rows` are for its use.

    Returns that follow each other in one voxel are a run. Runs are found without a branch, and all records of a chunk
    before any is changed, so that a processor waits for several at once.
    """
    slots, following, voxels = table.slots, table.following, table.voxels
    while start < len(points):
        count = min(_CHUNK, len(points) - start)
        if size + count > len(records) and len(records) < limit:
            break
        _prepare(points, start, count, origin, resolution, cells, units)
        found, known = _find_runs(cells, count, runs), size
        size = _find_records(cells, runs, found, slots, following, voxels, rows, size, limit)
        for i in range(known, size):
            records[i] = 0.0
            records[i, FIRST_SCAN], records[i, LAST_SCAN] = scan, -1.0
        for run in range(found):
            i = rows[run]
            if i < 0:
                continue
            records[i, SCANS] += 1.0 if records[i, LAST_SCAN] != scan else 0.0
            records[i, LAST_SCAN] = scan
            _gather(points, start, runs[run], runs[run + 1], units, records, i)
        start += count
    return size, start


@inlined
def _find_runs(cells: NDArray[np.int32], count: int, runs: Rows) -> int:
    """Fill `runs` with the first return of each run in `cells` (3, count), and `count` after them; returns how many."""
    one, found = np.uint64(1), np.uint64(1)
    runs[0] = 0
    for k in range(one, np.uint64(count)):
        runs[found] = k
        same = (cells[0, k] == cells[0, k - one]) & (cells[1, k] == cells[1, k - one])
        found += np.uint64(0) if same & (cells[2, k] == cells[2, k - one]) else one
    runs[found] = count
    return int(found)


@inlined
def _find_records(
    cells: NDArray[np.int32], runs: Rows, found: int, slots: NDArray[np.int32], following: NDArray[np.int32],
    voxels: NDArray[np.int32], rows: Rows, size: int, limit: int,
) -> int:  # fmt: skip
    """Fill `rows` with the record of each run, a new one where its voxel has none, -1 where there is no room for it.

    Returns how many records there are then.
    """
    for run in range(np.uint64(found)):
        k = np.uint64(runs[run])
        x, y, z = cells[0, k], cells[1, k], cells[2, k]
        i = find_in(slots, following, voxels, x, y, z)
        if i < 0 and size < limit:
            i = size
            size += 1
            add_to(slots, following, voxels, i, x, y, z)
        rows[run] = i
    return size


@inlined
def _prepare(
    points: NDArray[np.float32], start: int, count: int, origin: NDArray[np.float32], resolution: float,
    cells: NDArray[np.int32], units: NDArray[np.float32],
) -> None:  # fmt: skip
    """Voxels and unit vectors towards `origin` of `count` returns from row `start` on, many at once."""
    ox, oy, oz = origin[0], origin[1], origin[2]
    inverse_edge, begin = 1.0 / resolution, np.uint64(start)
    for a in range(3):
        for k in range(np.uint64(count)):
            units[a, k] = points[begin + k, a]
        for k in range(np.uint64(count)):
            cells[a, k] = np.int32(np.floor(np.float64(units[a, k]) * inverse_edge))
    for k in range(np.uint64(count)):
        dx, dy, dz = ox - units[0, k], oy - units[1, k], oz - units[2, k]
        inverse = np.float32(1.0) / (np.sqrt(dx * dx + dy * dy + dz * dz) + _TINY_M)
        units[0, k], units[1, k], units[2, k] = dx * inverse, dy * inverse, dz * inverse


@inlined
def _gather(
    points: NDArray[np.float32], start: int, first: int, last: int, units: NDArray[np.float32],
    records: NDArray[np.float64], i: int,
) -> None:  # fmt: skip
    """Add the returns from start + first up to start + last, all in one voxel, to record i."""
    sx, sy, sz, xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    ux, uy, uz = 0.0, 0.0, 0.0
    begin = np.uint64(start)  # rows of unsigned numbers are never counted from the end
    for k in range(np.uint64(first), np.uint64(last)):
        x, y, z = points[begin + k, 0], points[begin + k, 1], points[begin + k, 2]
        sx, sy, sz = sx + x, sy + y, sz + z
        xx, xy, xz = xx + x * x, xy + x * y, xz + x * z
        yy, yz, zz = yy + y * y, yz + y * z, zz + z * z
        ux, uy, uz = ux + units[0, k], uy + units[1, k], uz + units[2, k]
    sums, row = (float(last - first), sx, sy, sz, xx, xy, xz, yy, yz, zz, ux, uy, uz), np.uint64(i)
    for a in range(np.uint64(13)):
        records[row, a] += sums[a]


def pooled_covariances(
    positions: NDArray[np.float32], records: NDArray[np.float64], columns: PointColumns, resolution: float
) -> NDArray[np.float64]:
    """Covariance (m, 3, 3) of the returns around each of `positions` (m, 3): its 27 voxels, Gaussian in distance.

    `columns` are those of the neural points that the `records` belong to. A voxel counts at most as POOLED_RETURNS
    returns, so that dense and sparse scans give the same surface.
    """
    spreads = np.empty((len(columns.points), 1 + _SPREAD), dtype=np.float32)
    _own_spreads(columns.points, columns.rows, records, spreads)
    out, levels = np.empty((len(positions), 3, 3)), np.floor(columns.points[:, 2] / resolution).astype(np.int32)
    near, gaps = np.empty(len(levels) + 1, dtype=np.int64), np.empty((4, len(levels) + 1), dtype=np.float32)
    _pool(positions, columns, spreads, levels, resolution, near, gaps, out)
    return out


@loop
def _own_spreads(
    points: NDArray[np.float32], rows: NDArray[np.int32], records: NDArray[np.float64], spreads: NDArray[np.float32]
) -> None:
    """Fill `spreads` (n, 7) of neural points in the order of their columns: their weight, and the mean of the upper
    d d^T of their returns from the `points` (n, 3), which are their means.
    """
    for k in range(len(rows)):
        j = rows[k]
        n = records[j, 0]
        x, y, z = np.float64(points[k, 0]), np.float64(points[k, 1]), np.float64(points[k, 2])
        spreads[k, 0] = min(n, POOLED_RETURNS)
        spreads[k, 1] = (records[j, 4] - x * records[j, 1] - x * records[j, 1]) / n + x * x
        spreads[k, 2] = (records[j, 5] - x * records[j, 2] - y * records[j, 1]) / n + x * y
        spreads[k, 3] = (records[j, 6] - x * records[j, 3] - z * records[j, 1]) / n + x * z
        spreads[k, 4] = (records[j, 7] - y * records[j, 2] - y * records[j, 2]) / n + y * y
        spreads[k, 5] = (records[j, 8] - y * records[j, 3] - z * records[j, 2]) / n + y * z
        spreads[k, 6] = (records[j, 9] - z * records[j, 3] - z * records[j, 3]) / n + z * z


@loop
def _pool(
    positions: NDArray[np.float32], columns: PointColumns, spreads: NDArray[np.float32], levels: NDArray[np.int32],
    resolution: float, near: Rows, gaps: NDArray[np.float32], out: NDArray[np.float64],
) -> None:  # fmt: skip
    """Fill `out` (m, 3, 3): the returns of a neighbour spread around its mean, and with it around the query.

    `levels` (n,) are the heights of the neighbours' voxels; `near` and `gaps` (4, ...), of one more, are for its use.
    """
    keys, grid = columns.keys, columns.grid
    x_low, y_low, width, depth = columns.low[0], columns.low[1], columns.shape[0], columns.shape[1]
    farthest, scale = np.float32(4.0 * resolution**2), np.float32(-0.5 / (0.7 * resolution) ** 2)
    for i in range(len(positions)):
        px, py, pz = positions[i, 0], positions[i, 1], positions[i, 2]
        cx, cy, cz = int(np.floor(px / resolution)), int(np.floor(py / resolution)), int(np.floor(pz / resolution))
        found = 0
        for x in range(cx - 1 - x_low, cx + 2 - x_low):
            first, last = span(keys, grid, width, depth, x, cy - 1 - y_low, cy + 1 - y_low)
            found = _list_pooled(columns.points, levels, first, last, px, py, pz, cz, farthest, near, gaps, found)
        total, sx, sy, sz = 0.0, 0.0, 0.0, 0.0
        xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for n in range(np.uint64(found)):
            k, dx, dy, dz = np.uint64(near[n]), gaps[0, n], gaps[1, n], gaps[2, n]
            weight = np.exp(scale * gaps[3, n]) * spreads[k, 0]
            total, sx, sy, sz = total + weight, sx + weight * dx, sy + weight * dy, sz + weight * dz
            xx += weight * (spreads[k, 1] + dx * dx)
            xy += weight * (spreads[k, 2] + dx * dy)
            xz += weight * (spreads[k, 3] + dx * dz)
            yy += weight * (spreads[k, 4] + dy * dy)
            yz += weight * (spreads[k, 5] + dy * dz)
            zz += weight * (spreads[k, 6] + dz * dz)
        sx, sy, sz = sx / total, sy / total, sz / total
        out[i, 0, 0] = xx / total - sx * sx
        out[i, 0, 1] = out[i, 1, 0] = xy / total - sx * sy
        out[i, 0, 2] = out[i, 2, 0] = xz / total - sx * sz
        out[i, 1, 1] = yy / total - sy * sy
        out[i, 1, 2] = out[i, 2, 1] = yz / total - sy * sz
        out[i, 2, 2] = zz / total - sz * sz


@inlined
def _list_pooled(
    points: NDArray[np.float32], levels: NDArray[np.int32], first: int, last: int, px: np.float32, py: np.float32,
    pz: np.float32, cz: int, farthest: np.float32, near: Rows, gaps: NDArray[np.float32], found: int,
) -> int:  # fmt: skip
    """Add the points from `first` to before `last` that count at (px, py, pz) to the first `found` in `near`.

    `gaps` gets their differences and squared distances. Without a branch that depends on the data. Returns how many
    there are then.
    """
    for k in range(np.uint64(first), np.uint64(last)):
        dx, dy, dz, at = points[k, 0] - px, points[k, 1] - py, points[k, 2] - pz, np.uint64(found)
        gap = dx * dx + dy * dy + dz * dz
        near[at], gaps[0, at], gaps[1, at], gaps[2, at], gaps[3, at] = k, dx, dy, dz, gap
        found += 1 if (gap <= farthest) & (abs(levels[k] - cz) <= 1) else 0
    return found
