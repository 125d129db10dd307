"""Surface points with their normals, sorted for searches in vertical columns.

A search takes all points of the columns around, LANES at a time, without asking whether a column can still hold a
nearer one: a step that a processor guesses wrong costs more than the few distances it saves. Where the points of the
columns do not fill the last LANES, those that follow are looked at, too: they are points of the surface as well.

Distance and row are compared as one whole number: the bits of a positive float are in the order of its value.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, loop
from revisit.core.kernels.point_columns import columns_of, span

Array64 = NDArray[np.float64]
Records = NDArray[np.float32]

LANES = 16
"""Points whose distances are computed at once."""

_FAR = np.float32(1e9)  # where nothing is: its square is a float, too
_ROW = np.int64(0xFFFFFFFF)  # the half of a rank that is the row


class Patches(NamedTuple):
    """Small planes of a surface in the order of their columns.

    records (n, 8) float32: position, 0, unit normal, 0; rows (n,) int32, those before the sorting; keys, grid, low and
    shape as in `PointColumns`; places (3, n + LANES) float32, the positions, coordinates one after the other.
    """

    records: Records
    rows: NDArray[np.int32]
    keys: NDArray[np.int64]
    grid: NDArray[np.int32]
    low: NDArray[np.int64]
    shape: NDArray[np.int64]
    places: Records


def patches_of(points: Array64, normals: Array64, edge: float) -> Patches:
    """The patches of `points` (n, 3) with unit `normals` (n, 3), in columns of `edge` metres."""
    columns, count = columns_of(points, edge), len(points)
    records, places = np.zeros((count, 8), dtype=np.float32), np.full((3, count + LANES), _FAR)
    _fill(columns.points, columns.rows, normals, records, places)
    return Patches(records, columns.rows, columns.keys, columns.grid, columns.low, columns.shape, places)


@loop
def _fill(points: Array64, rows: NDArray[np.int32], normals: Array64, records: Records, places: Records) -> None:
    """Fill `records` and `places` with sorted points and their normals, which are not sorted."""
    for n in range(len(points)):
        i = rows[n]
        for a in range(3):
            records[n, a] = places[a, n] = points[n, a]
            records[n, 4 + a] = normals[i, a]


@inlined
def nearest_patch(
    places: Records, keys: NDArray[np.int64], grid: NDArray[np.int32], x_low: int, y_low: int, width: int, depth: int,
    edge: float, reach: float, px: float, py: float, pz: float,
) -> int:  # fmt: skip
    """The sorted row of the patch nearest to (px, py, pz) and nearer than `reach`, or -1. Of two the first."""
    qx, qy, qz, inverse = np.float32(px), np.float32(py), np.float32(pz), np.float32(1.0 / edge)
    limit, rings = _ranked(np.float32(reach * reach), 0), int(np.ceil(reach / edge))
    x, y = int(np.floor(qx * inverse)) - x_low, int(np.floor(qy * inverse)) - y_low
    y_first, y_end = max(y - rings, 0), min(y + rings, depth - 1) + 1
    least = limit
    if y_first < y_end:
        for column in range(max(x - rings, 0), min(x + rings, width - 1) + 1):
            first, end = _between(keys, grid, column * depth + y_first, column * depth + y_end)
            for block in range(first, end, LANES):
                for k in range(LANES):
                    least = min(least, _rank(places, block + k, qx, qy, qz))
    return int(least & _ROW) if least < limit else -1


@inlined
def two_nearest(
    places: Records, keys: NDArray[np.int64], grid: NDArray[np.int32], x_low: int, y_low: int, width: int, depth: int,
    edge: float, reach: float, px: float, py: float, pz: float,
) -> tuple[int, float, float]:  # fmt: skip
    """The sorted row of the patch nearest to (px, py, pz), or -1, and the distances of it and of the next one.

    Both are at most `reach`, and `reach` where there is none. The columns next to the point are looked through first,
    those farther away only where they can hold one of the two.
    """
    qx, qy, qz = np.float32(px), np.float32(py), np.float32(pz)
    limit = _ranked(np.float32(reach * reach), 0)
    least, next_least, home, home_end = limit, limit, 0, 0
    x_home, y_home = int(np.floor(px / edge)), int(np.floor(py / edge))
    aside = min(px - x_home * edge, py - y_home * edge)
    aside = edge + min(aside, min((x_home + 1) * edge - px, (y_home + 1) * edge - py))
    rings = 1
    for turn in range(2):  # the nine columns around, then those around them
        for x in range(x_home - rings, x_home + rings + 1):
            inside = turn == 1 and abs(x - x_home) <= 1
            for part in range(2 if inside else 1):
                y_first, y_last = y_home - rings, y_home + rings
                if inside:
                    y_first, y_last = (y_first, y_home - 2) if part == 0 else (y_home + 2, y_last)
                first, last = span(keys, grid, width, depth, x - x_low, y_first - y_low, y_last - y_low)
                for block in range(first, last, LANES):
                    here = _least_rank(places, block, last, -1, limit, qx, qy, qz)
                    next_least = min(next_least, max(least, here))
                    home, home_end = (block, last) if here < least else (home, home_end)
                    least = min(least, here)
        next_least = min(next_least, _least_rank(places, home, home_end, int(least & _ROW), limit, qx, qy, qz))
        farthest = _squared(next_least)
        if farthest <= aside * aside or turn == 1:
            break
        rings = int(np.ceil(np.sqrt(farthest) / edge))
    nearest = int(least & _ROW) if least < limit else -1
    return nearest, float(np.sqrt(_squared(least))), float(np.sqrt(_squared(next_least)))


@inlined
def _least_rank(
    places: Records, block: int, end: int, but: int, limit: int, qx: np.float32, qy: np.float32, qz: np.float32
) -> int:
    """The least rank, at most `limit`, of the LANES patches from `block` on that lie before `end` and are not `but`."""
    least = limit
    for k in range(LANES):
        here = _rank(places, block + k, qx, qy, qz)
        least = min(least, here if (block + k < end) & (block + k != but) else limit)
    return least


@inlined
def _rank(places: Records, row: int, qx: np.float32, qy: np.float32, qz: np.float32) -> int:
    """The squared distance of a patch and its row as one number, in the order of the distances."""
    i = np.uint64(row)
    dx, dy, dz = places[0, i] - qx, places[1, i] - qy, places[2, i] - qz
    return _ranked(np.float32(dx * dx + dy * dy + dz * dz), row)


@inlined
def _ranked(squared: np.float32, row: int) -> int:
    return int((np.int64(np.float32(squared).view(np.int32)) << 32) | np.int64(row))


@inlined
def _squared(rank: int) -> np.float32:
    return np.int32(rank >> 32).view(np.float32)


@inlined
def _between(keys: NDArray[np.int64], grid: NDArray[np.int32], begin: int, end: int) -> tuple[int, int]:
    """The points of the columns from `begin` to before `end`: a first row, and one past the last."""
    if len(grid):
        return grid[begin], grid[end]
    return int(np.searchsorted(keys, begin)), int(np.searchsorted(keys, end))
