"""The nearest points around queries, among points sorted by their columns of voxels (paper III-B 2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, loop
from revisit.core.kernels.point_columns import PointColumns, span

Keys = NDArray[np.int64]

_NOTHING = np.int64(0x7F800000 << 32)  # infinitely far
_ROW = np.int64(0xFFFFFFFF)
_FAR, _NONE = np.float32(np.inf), np.int32(-1)
_SIX = 6  # neighbours of a query in the map of a submap


def nearest_points(
    queries: NDArray[np.float32], columns: PointColumns, resolution: float, count: int, rings: int
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The `count` nearest points among the columns within `rings` voxels of each query (m, 3), nearest first.

    Returns rows (m, count) int32 of the points before they were sorted, -1 where fewer are nearer than `rings` voxel
    edges, and squared distances (m, count) float32, inf there. Of points equally far the one of the lower voxel counts.
    """
    found, squared = np.empty((len(queries), count), np.int32), np.empty((len(queries), count), np.float32)
    if len(columns.points) == 0:
        found[:], squared[:] = _NONE, _FAR
        return found, squared
    near, best = np.empty(len(columns.points) + 1, dtype=np.int64), np.empty(count, dtype=np.int64)
    held = np.empty(len(near), np.int64), np.empty((2, len(near)), columns.points.dtype)
    _find_nearest(queries, columns, resolution, rings, near, best, best.view(np.float32), *held, found, squared)
    return found, squared


@loop
def _find_nearest(
    queries: NDArray[np.float32], columns: PointColumns, resolution: float, rings: int, near: Keys, best: Keys,
    halves: NDArray[np.float32], held: Keys, levels: NDArray[np.floating], found: NDArray[np.int32],
    squared: NDArray[np.float32],
) -> None:  # fmt: skip
    """Fill `found` and `squared` (m, K). `near`, `best` (K,), `held` and `levels` (2, n) are for its use.

    `halves` are the bytes of `best`.

    A candidate is a number: the bits of its squared distance, which are in the order of the distances, above its row.
    So the nearest are kept in order by least and greatest of two numbers alone, without a branch to be guessed wrong.
    Queries that stand above each other, as the corners of voxels do, look through the same columns once.
    """
    points, rows, keys, grid = columns.points, columns.rows, columns.keys, columns.grid
    x_low, y_low, width, depth = columns.low[0], columns.low[1], columns.shape[0], columns.shape[1]
    reach, count, begin = np.float32((rings * resolution) ** 2), len(best), 0
    while begin < len(queries):
        px, py, end = queries[begin, 0], queries[begin, 1], begin + 1
        while end < len(queries) and queries[end, 0] == px and queries[end, 1] == py:
            end += 1
        cx, cy, size = int(np.floor(px / resolution)) - x_low, int(np.floor(py / resolution)) - y_low, 0
        if end > begin + 1:
            for x in range(cx - rings, cx + rings + 1):
                first, last = span(keys, grid, width, depth, x, cy - rings, cy + rings)
                size = _hold(points, first, last, px, py, reach, held, levels, size)
        for q in range(begin, end):
            best[:] = _NOTHING
            if end > begin + 1:
                _keep_nearest_held(queries[q, 2], reach, size, held, levels, near, best)
            for step in range(2 * rings + 1 if end == begin + 1 else 0):
                x = cx + (step + 1) // 2 * (1 - 2 * (step & 1))  # from the middle outwards
                gap = max((x + x_low) * resolution - px, px - (x + x_low + 1) * resolution, 0.0)
                farthest = min(reach, halves[2 * count - 1])
                if gap * gap <= farthest:
                    first, last = span(keys, grid, width, depth, x, cy - rings, cy + rings)
                    _keep_nearest(queries, q, points, first, last, farthest, near, best)
            for k in range(np.uint64(count)):  # without a branch: nothing has a row too, which is not taken
                gap, row = halves[np.uint64(2) * k + np.uint64(1)], rows[np.uint64(best[k] & _ROW)]
                squared[q, k], found[q, k] = gap if gap < reach else _FAR, row if gap < reach else _NONE
        begin = end


@inlined
def _hold(
    points: NDArray[np.floating], first: int, last: int, px: np.float32, py: np.float32, reach: np.float32, held: Keys,
    levels: NDArray[np.floating], size: int,
) -> int:  # fmt: skip
    """Add the points from `first` to before `last` that are near (px, py) to the first `size` in `held`.

    `levels` gets their squared distances from above, and their heights. Returns how many there are then.
    """
    for i in range(first, last):
        dx, dy = points[i, 0] - px, points[i, 1] - py
        held[size], levels[0, size], levels[1, size] = i, dx * dx + dy * dy, points[i, 2]
        size += 1 if levels[0, size] <= reach else 0
    return size


@inlined
def _keep_nearest(
    queries: NDArray[np.float32], q: int, points: NDArray[np.floating], first: int, last: int, farthest: np.float32,
    near: Keys, best: Keys,
) -> None:  # fmt: skip
    """Keep the nearest of the points from `first` to before `last` to query q."""
    px, py, pz, size = queries[q, 0], queries[q, 1], queries[q, 2], 0
    for i in range(first, last):
        dx, dy, dz = points[i, 0] - px, points[i, 1] - py, points[i, 2] - pz
        d = np.float32(dx * dx + dy * dy + dz * dz)
        near[size] = (np.int64(d.view(np.int32)) << 32) | i
        size += 1 if d <= farthest else 0
    _keep(near, size, best)


@inlined
def _keep_nearest_held(
    pz: np.float32, reach: np.float32, count: int, held: Keys, levels: NDArray[np.floating], near: Keys, best: Keys
) -> None:
    """Keep the nearest of the first `count` points in `held` to a query of height `pz`."""
    size = 0
    for n in range(count):
        dz = levels[1, n] - pz
        d = np.float32(levels[0, n] + dz * dz)
        near[size] = (np.int64(d.view(np.int32)) << 32) | held[n]
        size += 1 if d <= reach else 0
    _keep(near, size, best)


@inlined
def _keep(near: Keys, size: int, best: Keys) -> None:
    """Keep the least of `best` (K,) and of the first `size` candidates, in order."""
    if len(best) != _SIX:
        for n in range(size):
            candidate = near[n]
            for k in range(len(best)):
                kept = best[k]
                best[k], candidate = min(kept, candidate), max(kept, candidate)
        return
    a, b, c, d, e, f = best[0], best[1], best[2], best[3], best[4], best[5]  # they stay in registers
    for n in range(size):
        candidate = near[n]
        a, candidate = min(a, candidate), max(a, candidate)
        b, candidate = min(b, candidate), max(b, candidate)
        c, candidate = min(c, candidate), max(c, candidate)
        d, candidate = min(d, candidate), max(d, candidate)
        e, candidate = min(e, candidate), max(e, candidate)
        f = min(f, candidate)
    best[0], best[1], best[2], best[3], best[4], best[5] = a, b, c, d, e, f


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
