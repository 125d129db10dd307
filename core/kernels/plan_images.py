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
def layer_counts(points: Array64, pixel: float, size: int, layers: int, lowest: float, layer: float) -> Images:
    """How many of `points` (n, 3) lie in each layer of `layer` metres from `lowest` on: (layers, size, size).

    Rows are y and columns x of a square around the origin. What is lower or higher counts in the first or last layer.
    """
    counts, half = np.zeros((layers, size, size), dtype=np.float32), size // 2
    for n in range(len(points)):
        x, y = int(np.floor(points[n, 0] / pixel)) + half, int(np.floor(points[n, 1] / pixel)) + half
        if 0 <= x < size and 0 <= y < size:
            z = min(max((points[n, 2] - lowest) / layer, 0.0), layers - 1.0)
            counts[int(z), y, x] += np.float32(1.0)
    return counts


@numba.njit(cache=True, error_model="numpy")
def layer_products(
    standing: NDArray[np.complex64], seen: NDArray[np.complex64], layers: NDArray[np.complex64]
) -> NDArray[np.complex64]:
    """Spectra (8, y, x) of what `layers` (l, y, x) hits over all shifts, and of where it is seen.

    Of each, for the layers turned by 0 to 3 quarters: hits, then seen. `standing` (l, y, x) and `seen` (y, x) are the
    spectra of the other place; all are halves of spectra of square images of which x is halved. A quarter turn of the
    image turns its spectrum, but for one pixel in x; a half turn makes it its conjugate, but for one pixel in both,
    which is left to `plan_peaks`.
    """
    count, rows, columns = layers.shape
    found = np.zeros((8, rows, columns), dtype=np.complex64)
    by_pixel = np.exp(2j * np.pi * np.arange(columns) / rows).astype(np.complex64)
    for y in range(rows):
        for layer in range(count):
            for x in range(columns):
                value, other = layers[layer, y, x], standing[layer, y, x]
                if y < columns:
                    turned = by_pixel[x] * layers[layer, -x, y]  # -0 is 0, -1 the last one
                else:
                    turned = by_pixel[x] * np.conj(layers[layer, x, rows - y])
                found[0, y, x] += other * np.conj(value)
                found[1, y, x] += other * np.conj(turned)
                found[2, y, x] += other * value
                found[3, y, x] += other * turned
                found[4, y, x] += seen[y, x] * np.conj(value)
                found[5, y, x] += seen[y, x] * np.conj(turned)
                found[6, y, x] += seen[y, x] * value
                found[7, y, x] += seen[y, x] * turned
    return found


@numba.njit(cache=True, error_model="numpy")
def plan_shares(images: Images) -> tuple[Images, Images]:
    """Of hits and seen (8, y, x) as of `layer_products`: hits over at least 1 of seen, and seen, both (4, y, x)."""
    rows, columns = images.shape[1:]
    shape = (4, rows, columns)
    share, common = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    for quarter in range(4):
        step = quarter // 2  # after a half turn each moves on by one pixel
        for y in range(rows):
            for x in range(columns):
                seen = images[4 + quarter, y - step, x - step]  # -1 is the last one
                common[quarter, y, x] = seen
                share[quarter, y, x] = images[quarter, y - step, x - step] / max(seen, np.float32(1.0))
    return share, common


@numba.njit(cache=True, error_model="numpy")
def plan_peaks(share: Images, least: float, apart: float) -> NDArray[np.int64]:
    """Quarter, row and column (p, 3) of the local maxima of `share` (4, y, x) of at least `least`.

    The edges go round. Where nothing is turned none counts within `apart` pixels of no shift.
    """
    count, rows, columns = share.shape
    found = np.empty((count * rows * columns, 3), dtype=np.int64)
    peaks = 0
    for quarter in range(count):
        for y in range(rows):
            for x in range(columns):
                here = share[quarter, y, x]
                if here < least or (quarter == 0 and np.hypot(min(y, rows - y), min(x, columns - x)) < apart):
                    continue
                highest = True
                for dy in range(-1, 2):
                    for dx in range(-1, 2):
                        highest &= here >= share[quarter, (y + dy) % rows, (x + dx) % columns]
                if highest:
                    found[peaks] = quarter, y, x
                    peaks += 1
    return found[:peaks]
