"""The nearest points around queries, among points sorted by their columns of voxels (paper III-B 2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import loop
from revisit.core.kernels.point_columns import PointColumns, span

Keys = NDArray[np.int64]

_NOTHING = np.int64(0x7F800000 << 32)  # infinitely far
_ROW = np.int64(0xFFFFFFFF)


def nearest_points(
    queries: NDArray[np.float32], columns: PointColumns, resolution: float, count: int, rings: int
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The `count` nearest points among the columns within `rings` voxels of each query (m, 3), nearest first.

    Returns rows (m, count) int32 of the points before they were sorted, -1 where fewer are nearer than `rings` voxel
    edges, and squared distances (m, count) float32, inf there. Of points equally far the one of the lower voxel counts.
    """
    found = np.full((len(queries), count), -1, dtype=np.int32)
    squared = np.full((len(queries), count), np.inf, dtype=np.float32)
    near, best = np.empty(len(columns.points) + 1, dtype=np.int64), np.empty(count, dtype=np.int64)
    _find_nearest(queries, columns, resolution, rings, near, best, best.view(np.float32), found, squared)
    return found, squared


@loop
def _find_nearest(
    queries: NDArray[np.float32], columns: PointColumns, resolution: float, rings: int, near: Keys, best: Keys,
    halves: NDArray[np.float32], found: NDArray[np.int32], squared: NDArray[np.float32],
) -> None:  # fmt: skip
    """Fill `found` and `squared` (m, K). `near` and `best` (K,) are for its use; `halves` are the bytes of `best`.

    A candidate is a number: the bits of its squared distance, which are in the order of the distances, above its row.
    So the nearest are kept in order by least and greatest of two numbers alone, without a branch to be guessed wrong.
    """
    points, rows, keys, grid = columns.points, columns.rows, columns.keys, columns.grid
    x_low, y_low, width, depth = columns.low[0], columns.low[1], columns.shape[0], columns.shape[1]
    reach, count = np.float32((rings * resolution) ** 2), len(best)
    for q in range(len(queries)):
        px, py, pz = queries[q, 0], queries[q, 1], queries[q, 2]
        cx, cy = int(np.floor(px / resolution)), int(np.floor(py / resolution)) - y_low
        farthest = reach
        best[:] = _NOTHING
        for step in range(2 * rings + 1):
            x = cx + (step + 1) // 2 * (1 - 2 * (step & 1))  # from the middle outwards
            gap = max(x * resolution - px, px - (x + 1) * resolution, 0.0)
            if gap * gap > farthest:
                continue
            first, last = span(keys, grid, width, depth, x - x_low, cy - rings, cy + rings)
            size = 0
            for i in range(first, last):
                dx, dy, dz = points[i, 0] - px, points[i, 1] - py, points[i, 2] - pz
                d = np.float32(dx * dx + dy * dy + dz * dz)
                near[size] = (np.int64(d.view(np.int32)) << 32) | i
                size += 1 if d <= farthest else 0
            for n in range(size):
                candidate = near[n]
                for k in range(count):
                    kept = best[k]
                    best[k], candidate = min(kept, candidate), max(kept, candidate)
            farthest = min(reach, halves[2 * count - 1])
        for k in range(count):
            if halves[2 * k + 1] >= reach:
                break
            squared[q, k], found[q, k] = halves[2 * k + 1], rows[best[k] & _ROW]


def any_within(queries: NDArray[np.float32], columns: PointColumns, distance: float) -> NDArray[np.bool_]:
    """Whether any point lies within `distance` metres of each query (m, 3); `columns` have that edge."""
    found = np.zeros(len(queries), dtype=np.bool_)
    _find_any(queries, columns, distance, found)
    return found


@loop
def _find_any(queries: NDArray[np.float32], columns: PointColumns, distance: float, found: NDArray[np.bool_]) -> None:
    points, keys, grid = columns.points, columns.keys, columns.grid
    x_low, y_low, width, depth = columns.low[0], columns.low[1], columns.shape[0], columns.shape[1]
    for q in range(len(queries)):
        px, py, pz = np.float64(queries[q, 0]), np.float64(queries[q, 1]), np.float64(queries[q, 2])
        cx, cy = int(np.floor(px / distance)) - x_low, int(np.floor(py / distance)) - y_low
        for step in range(9):
            x = cx + (0, 1, -1)[step // 3]
            y = cy + (0, 1, -1)[step % 3]
            first, last = span(keys, grid, width, depth, x, y, y)
            for i in range(first, last):
                dx, dy, dz = points[i, 0] - px, points[i, 1] - py, points[i, 2] - pz
                if dx * dx + dy * dy + dz * dz <= distance * distance:
                    found[q] = True
                    break
            if found[q]:
                break
