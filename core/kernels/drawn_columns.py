"""Points of some vertical columns of space, drawn by where they stand."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

_TURN = 2654435761
_WHOLE = 2**32


@numba.njit(cache=True)
def points_of_drawn_columns(points: NDArray[np.float32], reach: float, wanted: int) -> NDArray[np.int64]:
    """Rows of `points` (n, 3) in columns of edge 1 within `reach` of the origin along x and y; about `wanted` of them.

    Where there are more, columns are drawn by a hash of their place: the same points give the same rows.
    """
    near = 0
    for i in range(len(points)):
        near += abs(points[i, 0]) < reach and abs(points[i, 1]) < reach
    limit = _WHOLE if near <= wanted else int(_WHOLE * (wanted / near))
    rows, count = np.empty(near, np.int64), 0
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        if abs(x) < reach and abs(y) < reach:
            column = (int(np.floor(x)) + 1024) * 2048 + int(np.floor(y)) + 1024
            if (column * _TURN) % _WHOLE < limit:
                rows[count] = i
                count += 1
    return rows[:count]
