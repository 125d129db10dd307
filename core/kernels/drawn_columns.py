"""Points of some vertical columns of space, drawn by where they stand (docs/decisions/0081)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import loop

_TURN = np.uint32(2654435761)
_SIDE = 2048  # columns along each axis, the origin in the middle
_FAR = np.uint32(2**32 - 1)


def points_of_drawn_columns(points: NDArray[np.float32], reach: float, wanted: int) -> NDArray[np.int64]:
    """Rows of `points` (n, 3) in columns of edge 1 within `reach` of the origin along x and y; about `wanted` of them.

    Where there are more, columns are drawn by a hash of their place: the same points give the same rows.
    """
    turned = np.empty(len(points), dtype=np.uint32)
    near = _turn_columns(np.ascontiguousarray(points).reshape(-1), np.float32(reach), turned)
    below = np.uint32(2**32 * (wanted / near)) if near > wanted else _FAR
    rows = np.empty(len(points), dtype=np.int32)
    return rows[: _draw(turned, below, rows)].astype(np.int64)


@loop
def _turn_columns(flat: NDArray[np.float32], reach: np.float32, turned: NDArray[np.uint32]) -> int:
    """Fill `turned` (n,) with the hashes of the points' columns, _FAR beyond reach; returns how many are within.

    Rows of unsigned numbers are never counted from the end.
    """
    middle, side, near = np.int32(_SIDE // 2), np.int32(_SIDE), 0
    for n in range(len(turned)):
        x, y = flat[np.uint64(3 * n)], flat[np.uint64(3 * n + 1)]
        column = (np.int32(np.floor(x)) + middle) * side + np.int32(np.floor(y)) + middle
        within = abs(x) < reach and abs(y) < reach
        turned[np.uint64(n)] = np.uint32(np.uint32(column) * _TURN) if within else _FAR
        near += 1 if within else 0
    return near


@loop
def _draw(turned: NDArray[np.uint32], below: np.uint32, rows: NDArray[np.int32]) -> int:
    """List the rows (n,) whose number is less than `below`; returns how many. No branch is guessed wrong."""
    count = 0
    for n in range(np.uint64(len(turned))):
        rows[np.uint64(count)] = n
        count += 1 if turned[n] < below else 0
    return count
