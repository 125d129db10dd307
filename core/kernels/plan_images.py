"""Places drawn from above: density for phase correlation, and layers of height for rivals (docs/decisions/0080)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import compiled, inner, loop

Array64 = NDArray[np.float64]
Images = NDArray[np.float32]


def plan_density(points: Array64, yaw: float, pixel: float, size: int) -> Array64:
    """log(1 + count) of `points` (n, 2), turned by `yaw`, in each pixel, smoothed by a cross and free of its mean.

    (size, size) around the origin, rows are y; points outside are left out; the edges go round.
    """
    image, counts = np.zeros((size, size)), np.zeros((size, size), dtype=np.int32)
    _draw_density(points, yaw, pixel, counts, np.log1p(np.arange(len(points) + 1.0)), image)
    image -= image.sum() / (size * size)
    return image


@loop
def _draw_density(
    points: Array64, yaw: float, pixel: float, counts: NDArray[np.int32], logarithms: Array64, image: Array64
) -> None:
    """Add up `counts` and draw `image`; both are 0. `logarithms` are those of 1, 2 and so on."""
    size, half = len(counts), len(counts) // 2
    cosine, sine = np.cos(yaw), np.sin(yaw)
    for n in range(len(points)):
        x = int(np.floor((points[n, 0] * cosine - points[n, 1] * sine) / pixel)) + half
        y = int(np.floor((points[n, 0] * sine + points[n, 1] * cosine) / pixel)) + half
        if 0 <= x < size and 0 <= y < size:
            counts[y, x] += 1
    for y in range(size):
        for x in range(size):
            if counts[y, x]:
                here = logarithms[counts[y, x]]
                image[y, x] += here
                image[y - 1, x] += 0.5 * here
                image[y + 1 if y + 1 < size else 0, x] += 0.5 * here
                image[y, x - 1] += 0.5 * here
                image[y, x + 1 if x + 1 < size else 0] += 0.5 * here


@compiled
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


def occupied_around(
    points: Array64, pixel: float, size: int, layers: int, lowest: float, layer: float, reach: int
) -> Images:
    """1 in each pixel within `reach` pixels, in rows and columns, of one in which a point lies, by layers; else 0.

    Pixels and layers as in `layer_counts`; the edges go round.
    """
    images = np.zeros((layers, size, size), dtype=np.float32)
    _mark_around(points, pixel, lowest, layer, reach, images)
    return images


@loop
def _mark_around(points: Array64, pixel: float, lowest: float, layer: float, reach: int, images: Images) -> None:
    """Mark `images`, which are 0."""
    layers, size, half = images.shape[0], images.shape[1], images.shape[1] // 2
    for n in range(len(points)):
        x, y = int(np.floor(points[n, 0] / pixel)) + half, int(np.floor(points[n, 1] / pixel)) + half
        if not (0 <= x < size and 0 <= y < size):
            continue
        z = int(min(max((points[n, 2] - lowest) / layer, 0.0), layers - 1.0))
        for down in range(y - reach, y + reach + 1):
            row = down - size if down >= size else down  # -1 is the last one
            for right in range(x - reach, x + reach + 1):
                images[z, row, right - size if right >= size else right] = np.float32(1.0)


def hit_products(
    standing: NDArray[np.complex64], layers: NDArray[np.complex64]
) -> tuple[NDArray[np.complex64], NDArray[np.complex64]]:
    """Spectra (4, y, x) of what `layers` (l, y, x), turned by 0 to 3 quarters, hit of `standing` over all shifts.

    And the sums (2, y, x) over the layers of those of which the conjugate, times the spectrum of where the other place
    has seen, is that of what is seen of them: turned by none and one quarter. Two quarters more leave the conjugate
    out. `standing` (l, y, x) are the spectra of the other place; all are halves of spectra of square images of which x
    is halved. A quarter turn of the image turns its spectrum, but for one pixel in x; a half turn makes it its
    conjugate, but for one pixel in both, which is left to who reads the shifts.
    """
    rows, columns = layers.shape[1:]
    hits, totals = np.zeros((4, rows, 2 * columns), np.float32), np.zeros((2, rows, 2 * columns), np.float32)
    by_pixel = np.exp(2j * np.pi * np.arange(columns) / rows).astype(np.complex64)
    real, other = np.ascontiguousarray(layers).view(np.float32), np.ascontiguousarray(standing).view(np.float32)
    _multiply_layers(other, real, by_pixel.view(np.float32), np.empty(2 * columns, np.float32), hits, totals)
    return hits.view(np.complex64), totals.view(np.complex64)


@loop
def _multiply_layers(
    standing: Images, layers: Images, by_pixel: Images, turned: Images, hits: Images, totals: Images
) -> None:
    """Add up `hits` and `totals`. All numbers are complex: pairs of real ones along x; `turned` is for its use."""
    count, rows, columns = layers.shape[0], layers.shape[1], layers.shape[2] // 2
    for layer in range(count):
        for y in range(rows):
            for x in range(columns):
                if y < columns:
                    up, right, sign = rows - x if x else 0, 2 * y, np.float32(1.0)
                else:  # the half that is not there is the conjugate
                    up, right, sign = x, 2 * (rows - y), np.float32(-1.0)
                real, imaginary = layers[layer, up, right], sign * layers[layer, up, right + 1]
                c, s = by_pixel[2 * x], by_pixel[2 * x + 1]
                turned[2 * x], turned[2 * x + 1] = c * real - s * imaginary, c * imaginary + s * real
            _add_products(standing[layer, y], layers[layer, y], hits[0, y], hits[2, y], totals[0, y])
            _add_products(standing[layer, y], turned, hits[1, y], hits[3, y], totals[1, y])


@inner
def _add_products(standing: Images, layer: Images, hits: Images, hits_behind: Images, total: Images) -> None:
    """Add a row of `standing` times the conjugate of `layer`, and times it, to the hits, and `layer` to `total`."""
    for x in range(np.uint64(len(layer) // 2)):
        u, v = np.uint64(2 * x), np.uint64(2 * x + 1)
        a, b, p, q = layer[u], layer[v], standing[u], standing[v]
        hits[u] += p * a + q * b
        hits[v] += q * a - p * b
        hits_behind[u] += p * a - q * b
        hits_behind[v] += q * a + p * b
    for x in range(np.uint64(len(layer))):
        total[x] += layer[x]


def plan_shares(hits: Images, seen: Images, least: float) -> Images:
    """Hits over at least 1 of seen, all (q, y, x); 0 where fewer than `least` are seen."""
    shares = np.empty(hits.shape, dtype=np.float32)
    _divide(hits.reshape(-1), seen.reshape(-1), np.float32(least), shares.reshape(-1))
    return shares


@loop
def _divide(hits: Images, seen: Images, least: np.float32, shares: Images) -> None:
    """Fill `shares` (n,)."""
    for k in range(np.uint64(len(hits))):
        common = seen[k]
        shares[k] = hits[k] / max(common, np.float32(1.0)) if common >= least else np.float32(0.0)


def plan_peaks(share: Images, least: float, apart: float) -> NDArray[np.int64]:
    """Image, row and column (p, 3) of the local maxima of `share` (q, y, x) of at least `least`.

    The edges go round. In the first image none counts within `apart` pixels of no shift.
    """
    found = np.empty((share.size, 3), dtype=np.int64)
    return found[: _find_peaks(share, least, apart, found)]


@loop
def _find_peaks(share: Images, least: float, apart: float, found: NDArray[np.int64]) -> int:
    """Fill the first rows of `found` (n, 3); returns how many there are."""
    count, rows, columns = share.shape
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
                    found[peaks, 0], found[peaks, 1], found[peaks, 2] = quarter, y, x
                    peaks += 1
    return peaks
