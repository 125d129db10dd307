"""Range images of scans, and which positions they were looked through (paper III-B 4, Eq. 6)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

_PIXELS_PER_DEGREE = 1
_COLUMNS = 360 * _PIXELS_PER_DEGREE
_ROWS = 180 * _PIXELS_PER_DEGREE
_MARGIN_M = 0.5
_MARGIN_RATIO = 0.02


@numba.njit(inline="always")
def _pixel(x: float, y: float, z: float) -> tuple[int, int, float]:
    distance = np.sqrt(x * x + y * y + z * z) + 1e-9
    column = int((np.arctan2(y, x) + np.pi) * (_COLUMNS / (2 * np.pi))) % _COLUMNS
    row = min(_ROWS - 1, int((np.arcsin(z / distance) + np.pi / 2) * (_ROWS / np.pi)))
    return row, column, distance


@numba.njit(cache=True)
def range_image(points: Array, origin: Array) -> Array:
    """Smallest range to `points` (n, 3) seen from `origin` (3,) in each pixel: (rows, columns) float32 metres.

    Infinite where nothing was measured.
    """
    image = np.full((_ROWS, _COLUMNS), np.inf, dtype=np.float32)
    for n in range(len(points)):
        row, column, distance = _pixel(points[n, 0] - origin[0], points[n, 1] - origin[1], points[n, 2] - origin[2])
        image[row, column] = min(image[row, column], np.float32(distance))
    return image


@numba.njit(cache=True)
def mark_seen_through(positions: Array, origin: Array, image: Array, counts: NDArray[np.int32]) -> None:
    """Count the scan where all returns in the 3 x 3 pixels around a position are beyond it, and at least two exist."""
    for i in range(len(positions)):
        row, column, distance = _pixel(
            positions[i, 0] - origin[0], positions[i, 1] - origin[1], positions[i, 2] - origin[2]
        )
        nearest, measured = np.inf, 0
        for r in range(max(0, row - 1), min(_ROWS, row + 2)):
            for c in range(column - 1, column + 2):
                value = image[r, c % _COLUMNS]
                if np.isfinite(value):
                    measured += 1
                    nearest = min(nearest, value)
        if measured >= 2 and nearest > distance * (1 + _MARGIN_RATIO) + _MARGIN_M:
            counts[i] += 1
