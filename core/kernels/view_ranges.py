"""How far a place has looked in each direction, and what of another place stands before that."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array64 = NDArray[np.float64]

LOWEST_DEG = -60.0
ROWS = 40


@numba.njit(cache=True, error_model="numpy")
def nearest_ranges(points: Array64, angle_deg: float, columns: int) -> Array64:
    """The nearest range (columns, ROWS) in metres of `points` (n, 3) by azimuth and elevation; infinite for none."""
    image = np.full((columns, ROWS), np.inf)
    for n in range(len(points)):
        column, row = _direction(points[n, 0], points[n, 1], points[n, 2], angle_deg, columns)
        image[column, row] = min(image[column, row], np.sqrt(_squared(points[n])))
    return image


@numba.njit(cache=True, error_model="numpy")
def nearest_around(image: Array64) -> Array64:
    """The smallest value of each pixel and its eight neighbours; azimuth (rows of the array) goes round."""
    columns, rows = image.shape
    found = image.copy()
    for i in range(columns):
        for j in range(rows):
            for di in range(-1, 2):
                for dj in range(max(j - 1, 0), min(j + 2, rows)):
                    found[i, j] = min(found[i, j], image[(i + di) % columns, dj])
    return found


@numba.njit(cache=True, error_model="numpy")
def looked_through(
    points: Array64, image: Array64, around: Array64, angle_deg: float, near: float, far: float, margin: float
) -> tuple[int, int]:
    """How many of `points` (n, 3) were looked through, and of how many a place tells anything.

    `image` is that of `nearest_ranges`, `around` that of `nearest_around`. Points nearer than `near` or farther than
    `far` do not count; behind a point by more than `margin` lies what was seen through it.
    """
    through, confirmed = 0, 0
    for n in range(len(points)):
        distance = np.sqrt(_squared(points[n]))
        if distance <= near or distance >= far:
            continue
        column, row = _direction(points[n, 0], points[n, 1], points[n, 2], angle_deg, len(image))
        if not np.isfinite(image[column, row]):
            continue
        behind = around[column, row] - distance
        through += behind > margin
        confirmed += abs(behind) <= margin
    return through, through + confirmed


@numba.njit(inline="always")
def _direction(x: float, y: float, z: float, angle_deg: float, columns: int) -> tuple[int, int]:
    azimuth = np.degrees(np.arctan2(y, x)) + 180.0
    elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
    row = int(np.floor((elevation - LOWEST_DEG) / angle_deg))
    return int(azimuth / angle_deg) % columns, min(max(row, 0), ROWS - 1)


@numba.njit(inline="always")
def _squared(point: Array64) -> float:
    return float(point[0] * point[0] + point[1] * point[1] + point[2] * point[2])
