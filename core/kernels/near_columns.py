"""Which column of cubes each return of a submap lies in, in one pass (docs/decisions/0194)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import loop

SIDE = 2048
"""Columns along each axis, the origin in the middle."""


def near_columns(points: NDArray[np.float32], reach: float, edge: float) -> NDArray[np.int32]:
    """The column (n,) of edge `edge` metres of each of `points` (n, 3), x * SIDE + y; -1 beyond `reach` in x or y."""
    columns = np.empty(len(points), dtype=np.int32)
    _find_columns(np.ascontiguousarray(points).reshape(-1), np.float32(reach), np.float32(edge), columns)
    return columns


@loop
def _find_columns(flat: NDArray[np.float32], reach: np.float32, edge: np.float32, columns: NDArray[np.int32]) -> None:
    """Fill `columns` (n,). Rows of unsigned numbers are never counted from the end (0177)."""
    middle, side = np.int32(SIDE // 2), np.int32(SIDE)
    for n in range(len(columns)):
        x, y = flat[np.uint64(3 * n)], flat[np.uint64(3 * n + 1)]
        column = (np.int32(np.floor(x / edge)) + middle) * side + np.int32(np.floor(y / edge)) + middle
        columns[np.uint64(n)] = column if abs(x) < reach and abs(y) < reach else np.int32(-1)
