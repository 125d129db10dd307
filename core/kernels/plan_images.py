"""Places drawn from above: density for phase correlation, and layers of height for rivals (docs/decisions/0080)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array64 = NDArray[np.float64]
Images = NDArray[np.float32]


@numba.njit(cache=True, error_model="numpy")
def plan_density(points: Array64, yaw: float, pixel: float, size: int) -> Array64:
    """log(1 + count) of `points` (n, 2), turned by `yaw`, in each pixel, smoothed by a cross and free of its mean.

    (size, size) around the origin, rows are y; points outside are left out; the edges go round.
    """
    counts, half = np.zeros((size, size)), size // 2
    cosine, sine = np.cos(yaw), np.sin(yaw)
    for n in range(len(points)):
        x = int(np.floor((points[n, 0] * cosine - points[n, 1] * sine) / pixel)) + half
        y = int(np.floor((points[n, 0] * sine + points[n, 1] * cosine) / pixel)) + half
        if 0 <= x < size and 0 <= y < size:
            counts[y, x] += 1.0
    image = np.zeros((size, size))
    for y in range(size):
        for x in range(size):
            if counts[y, x] > 0.0:
                here = np.log1p(counts[y, x])
                image[y, x] += here
                image[y - 1, x] += 0.5 * here
                image[(y + 1) % size, x] += 0.5 * here
                image[y, x - 1] += 0.5 * here
                image[y, (x + 1) % size] += 0.5 * here
    image -= image.sum() / (size * size)
    return image


@numba.njit(cache=True, error_model="numpy")
def layer_counts(
    points: Array64, turned: bool, pixel: float, size: int, layers: int, lowest: float, layer: float
) -> Images:
    """How many of `points` (n, 3) lie in each layer of `layer` metres from `lowest` on: (layers, size, size).

    Rows are y and columns x of a square around the origin; `turned` by a quarter, (x, y) becomes (-y, x). What is
    lower or higher counts in the first or last layer.
    """
    counts, half = np.zeros((layers, size, size), dtype=np.float32), size // 2
    for n in range(len(points)):
        px, py = (-points[n, 1], points[n, 0]) if turned else (points[n, 0], points[n, 1])
        x, y = int(np.floor(px / pixel)) + half, int(np.floor(py / pixel)) + half
        if 0 <= x < size and 0 <= y < size:
            z = min(max((points[n, 2] - lowest) / layer, 0.0), layers - 1.0)
            counts[int(z), y, x] += np.float32(1.0)
    return counts


@numba.njit(cache=True, error_model="numpy")
def layer_products(
    standing: NDArray[np.complex64], seen: NDArray[np.complex64], layers: NDArray[np.complex64]
) -> NDArray[np.complex64]:
    """Spectra (4, y, x) of what `layers` (l, y, x) hits over all shifts, and of where it is seen; of each the straight
    one and that of the layers turned by half a turn.

    `standing` (l, y, x) and `seen` (y, x) are the spectra of the other place. The spectrum of a real image turned by
    half a turn is the conjugate, shifted by one pixel, which is left to `plan_shares`.
    """
    count, rows, columns = layers.shape
    found = np.zeros((4, rows, columns), dtype=np.complex64)
    for y in range(rows):
        for layer in range(count):
            for x in range(columns):
                value, other = layers[layer, y, x], standing[layer, y, x]
                found[0, y, x] += other * np.conj(value)
                found[1, y, x] += other * value
                found[2, y, x] += seen[y, x] * np.conj(value)
                found[3, y, x] += seen[y, x] * value
    return found


@numba.njit(cache=True, error_model="numpy")
def plan_shares(hits: Images, seen: Images, half_turn: bool) -> tuple[Images, Images]:
    """`hits` over at least 1 of `seen`, and `seen`, both (y, x); after a half turn each moves on by one pixel."""
    rows, columns = hits.shape
    share, common = np.empty((rows, columns), dtype=np.float32), np.empty((rows, columns), dtype=np.float32)
    step = 1 if half_turn else 0
    for y in range(rows):
        for x in range(columns):
            y_from, x_from = y - step, x - step  # -1 is the last one
            common[y, x] = seen[y_from, x_from]
            share[y, x] = hits[y_from, x_from] / max(seen[y_from, x_from], np.float32(1.0))
    return share, common
