"""Range images of scans, and which positions they were looked through (paper III-B 4, Eq. 6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.arcs import arc_tangent_32
from revisit.core.kernels.loops import compiled, inlined

Array = NDArray[np.float32]

COLUMNS = 360
ROWS = 180
PIXELS_PER_RADIAN = np.float32(180.0 / np.pi)
_HALF_TURN, _QUARTER_TURN = np.float32(np.pi), np.float32(0.5 * np.pi)
MARGIN_M, FARTHER = np.float32(0.5), np.float32(1.02)
_CHUNK = 1024
_STRETCHES = 4


@compiled
def range_image(points: Array, origin: Array) -> Array:
    """Smallest range to `points` (n, 3) seen from `origin` (3,) in each pixel: (rows, columns) float32 metres.

    A pixel is a degree wide and high. Infinite where nothing was measured.
    """
    image = np.full(ROWS * COLUMNS, np.inf, dtype=np.float32)
    rays, pixels, ranges = np.empty((3, _CHUNK), np.float32), np.empty(_CHUNK, np.int32), np.empty(_CHUNK, np.float32)
    for start in range(0, len(points), _CHUNK):
        count = min(_CHUNK, len(points) - start)
        _see(points, start, count, origin, rays, pixels, ranges)
        # Returns that follow each other see one pixel: of four stretches by turns, none waits for the one before.
        stretch = -(-count // _STRETCHES)
        for k in range(count, _STRETCHES * stretch):
            pixels[k], ranges[k] = 0, np.inf
        for k in range(np.uint64(stretch)):
            for part in range(np.uint64(_STRETCHES)):
                at = k + part * np.uint64(stretch)
                pixel = np.uint64(pixels[at])
                image[pixel] = min(image[pixel], ranges[at])
    return image.reshape(ROWS, COLUMNS)


@compiled
def mark_seen_through(positions: Array, origin: Array, image: Array, counts: NDArray[np.int32]) -> None:
    """Count the scan where all returns in the 3 x 3 pixels around a position are beyond it, and at least two exist."""
    nearest = _nearest_around(image)
    rays, pixels, ranges = np.empty((3, _CHUNK), np.float32), np.empty(_CHUNK, np.int32), np.empty(_CHUNK, np.float32)
    for start in range(0, len(positions), _CHUNK):
        count = min(_CHUNK, len(positions) - start)
        _see(positions, start, count, origin, rays, pixels, ranges)
        for k in range(count):
            counts[start + k] += nearest[pixels[k]] > ranges[k] * FARTHER + MARGIN_M


@inlined
def _see(
    points: Array, start: int, count: int, origin: Array, rays: Array, pixels: NDArray[np.int32], ranges: Array
) -> None:  # fmt: skip
    """The pixels and ranges of `count` points from row `start` on: without a branch, so that many are done at once."""
    begin, size = np.uint64(start), np.uint64(count)
    for a in range(3):
        for k in range(size):
            rays[a, k] = points[begin + k, a] - origin[a]
    for k in range(size):
        x, y, z = rays[0, k], rays[1, k], rays[2, k]
        level = x * x + y * y
        ranges[k] = np.sqrt(level + z * z)
        column = np.int32((arc_tangent_32(y, x) + _HALF_TURN) * PIXELS_PER_RADIAN)
        row = np.int32((arc_tangent_32(z, np.sqrt(level)) + _QUARTER_TURN) * PIXELS_PER_RADIAN)
        row = row if row < ROWS else np.int32(ROWS - 1)
        pixels[k] = row * np.int32(COLUMNS) + (column if column < COLUMNS else np.int32(0))


@compiled
def _nearest_around(image: Array) -> Array:
    """The smallest range (rows * columns,) of each pixel and its neighbours; 0 where fewer than two have one."""
    nearest = np.empty(ROWS * COLUMNS, dtype=np.float32)
    least, measured = np.empty(COLUMNS + 2, np.float32), np.empty(COLUMNS + 2, np.int32)  # of three rows, and around
    for row in range(ROWS):
        above, here, below = image[max(row - 1, 0)], image[row], image[min(row + 1, ROWS - 1)]
        inner, outer = 1 if row > 0 else 0, 1 if row < ROWS - 1 else 0
        for c in range(np.uint64(COLUMNS)):
            least[c + np.uint64(1)] = min(above[c], here[c], below[c])
            found = inner * np.int32(above[c] < np.inf) + np.int32(here[c] < np.inf)
            measured[c + np.uint64(1)] = found + outer * np.int32(below[c] < np.inf)
        least[0], least[-1], measured[0], measured[-1] = least[-2], least[1], measured[-2], measured[1]
        line = nearest[row * COLUMNS : (row + 1) * COLUMNS]
        for c in range(np.uint64(COLUMNS)):
            count = measured[c] + measured[c + np.uint64(1)] + measured[c + np.uint64(2)]
            value = min(least[c], least[c + np.uint64(1)], least[c + np.uint64(2)])
            line[c] = value if count >= 2 else np.float32(0.0)
    return nearest
