"""The range of a place in each direction, and points of another place that stand before it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, loop

Array64 = NDArray[np.float64]

LOWEST_DEG = -60.0
ROWS = 40


def nearest_ranges(points: Array64, angle_deg: float, columns: int) -> Array64:
    """The nearest range (columns, ROWS) in metres of `points` (n, 3) by azimuth and elevation; infinite for none."""
    image = np.full((columns, ROWS), np.inf)
    _draw(points, angle_deg, image)
    return image


@loop
def _draw(points: Array64, angle_deg: float, image: Array64) -> None:
    """Lower `image` to the ranges of `points`."""
    for n in range(len(points)):
        column, row = _direction(points[n, 0], points[n, 1], points[n, 2], angle_deg, len(image))
        image[column, row] = min(image[column, row], np.sqrt(_squared(points[n])))


def nearest_around(image: Array64) -> Array64:
    """The smallest value of each pixel and its eight neighbours; azimuth (rows of the array) goes round."""
    along, found = np.empty_like(image), np.empty_like(image)
    _lower_around(image, along, found)
    return found


@loop
def _lower_around(image: Array64, along: Array64, found: Array64) -> None:
    """Fill `found`; `along` is for its use."""
    columns, rows = image.shape
    for i in range(columns):
        for j in range(np.uint64(rows)):
            along[i, j] = min(min(image[i - 1, j], image[i, j]), image[i + 1 if i + 1 < columns else 0, j])
    for i in range(columns):
        for j in range(rows):
            lower, higher = max(j - 1, 0), min(j + 1, rows - 1)
            found[i, j] = min(min(along[i, lower], along[i, j]), along[i, higher])


@loop
def looked_through(
    points: Array64, T_view_points: Array64, image: Array64, around: Array64, angle_deg: float, near: float,
    far: float, margin: float,
) -> tuple[int, int]:  # fmt: skip
    """How many of `points` (n, 3), moved by `T_view_points` (4, 4), were looked through, and of how many a place tells
    anything.

    `image` is that of `nearest_ranges`, `around` that of `nearest_around`. Points nearer than `near` or farther than
    `far` do not count; behind a point by more than `margin` lies the surface seen through it.
    """
    through, confirmed, T = 0, 0, T_view_points
    for n in range(len(points)):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        distance = np.sqrt(x * x + y * y + z * z)
        if distance <= near or distance >= far:
            continue
        column, row = _direction(x, y, z, angle_deg, len(image))
        if not np.isfinite(image[column, row]):
            continue
        behind = around[column, row] - distance
        through += behind > margin
        confirmed += abs(behind) <= margin
    return through, through + confirmed


@inlined
def _direction(x: float, y: float, z: float, angle_deg: float, columns: int) -> tuple[int, int]:
    """Column and row of a direction. An arcus tangent that is a little off tells, but near the edge of a pixel."""
    level, slack = np.sqrt(x * x + y * y), _ABOUT_DEG / angle_deg
    azimuth, elevation = _about_deg(y, x) + 180.0, _about_deg(z, level)
    along, up = azimuth / angle_deg, (elevation - LOWEST_DEG) / angle_deg
    if abs(along - np.rint(along)) < slack or abs(up - np.rint(up)) < slack:
        along = (np.degrees(np.arctan2(y, x)) + 180.0) / angle_deg
        up = (np.degrees(np.arctan2(z, np.hypot(x, y))) - LOWEST_DEG) / angle_deg
    return int(along) % columns, min(max(int(np.floor(up)), 0), ROWS - 1)


_ABOUT_DEG = 2e-3  # more than `_about_deg` is off


@inlined
def _about_deg(y: float, x: float) -> float:
    """The angle of (x, y) in degrees within 0.0006: a polynomial of the arcus tangent (Abramowitz, Stegun 4.4.49)."""
    across, along = abs(y), abs(x)
    ratio = min(across, along) / max(max(across, along), 1e-300)
    square = ratio * ratio
    angle = 0.9998660 + square * (-0.3302995 + square * (0.1801410 + square * (-0.0851330 + square * 0.0208351)))
    angle = np.degrees(angle * ratio)
    angle = 90.0 - angle if across > along else angle
    angle = 180.0 - angle if x < 0.0 else angle
    return float(-angle if y < 0.0 else angle)


@inlined
def _squared(point: Array64) -> float:
    return float(point[0] * point[0] + point[1] * point[1] + point[2] * point[2])
