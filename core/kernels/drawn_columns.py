"""Points of some vertical columns of space, drawn by where they stand (docs/decisions/0194)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import loop

_TURN = np.uint32(2654435761)
_SIDE = 2048  # columns along each axis, the origin in the middle
_NONE = -1


def points_of_drawn_columns(points: NDArray[np.float32], reach: float, wanted: int) -> NDArray[np.int64]:
    """Rows of `points` (n, 3) in columns of edge 1 within `reach` of the origin along x and y; about `wanted` of them.

    Where there are more, columns are drawn by a hash of their place: the same points give the same rows.
    """
    columns = np.empty(len(points), dtype=np.int32)
    _find_columns(np.ascontiguousarray(points).reshape(-1), np.float32(reach), columns)
    drawn = columns != _NONE
    near = np.count_nonzero(drawn)
    if near > wanted:
        drawn &= (columns.view(np.uint32) * _TURN) < np.uint32(2**32 * (wanted / near))
    return np.flatnonzero(drawn)


@loop
def _find_columns(flat: NDArray[np.float32], reach: np.float32, columns: NDArray[np.int32]) -> None:
    """Fill `columns` (n,). Rows of unsigned numbers are never counted from the end (0177)."""
    middle, side = np.int32(_SIDE // 2), np.int32(_SIDE)
    for n in range(len(columns)):
        x, y = flat[np.uint64(3 * n)], flat[np.uint64(3 * n + 1)]
        column = (np.int32(np.floor(x)) + middle) * side + np.int32(np.floor(y)) + middle
        columns[np.uint64(n)] = column if abs(x) < reach and abs(y) < reach else np.int32(_NONE)
