"""Orientation histograms of rotated patches (paper III-D)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import compiled, fast

Array = NDArray[np.float32]


@compiled
def patch_histograms(
    index: NDArray[np.int8],
    weights: Array,
    pixels: NDArray[np.int64],
    angles: Array,
    patch: int,
    step: int,
    cells: int,
    bins: int,
) -> Array:
    """Weighted counts (n, cells * cells * bins) of the orientations around each of `pixels` (n, 2), column and row.

    The patch of `patch` pixels, sampled every `step`, is turned by the keypoint's angle (n,); its parts are counted
    apart, row by row. `index` (h, w) is the orientation of a pixel in 0..bins - 1, `weights` (h, w) what it counts.
    An orientation between two bins is shared by both.
    """
    height, width = index.shape
    histograms = np.zeros((len(pixels), cells * cells * bins), dtype=np.float32)
    steps = (patch + step - 1) // step
    offsets, part = np.empty(steps), np.empty(steps, dtype=np.int64)
    shares, lowers, uppers = np.empty(bins), np.empty(bins, dtype=np.int64), np.empty(bins, dtype=np.int64)
    for i in range(steps):
        offsets[i] = i * step + 0.5 * step - 0.5 * patch
        part[i] = i * step * cells // patch
    for keypoint in range(len(pixels)):
        cosine, sine = np.cos(angles[keypoint]), np.sin(angles[keypoint])
        turn = angles[keypoint] * bins / np.pi
        for orientation in range(bins):
            relative = orientation - turn
            # an angle of pi, rounded up, turns the first bin a little beyond the last
            relative = max(relative + bins, 0.0) if relative < 0.0 else relative
            lower = int(relative)
            shares[orientation] = relative - lower
            lowers[orientation], uppers[orientation] = lower % bins, lower + 1 if lower + 1 < bins else 0
        for i in range(steps):
            for j in range(steps):
                column = int(np.rint(pixels[keypoint, 0] + cosine * offsets[j] - sine * offsets[i]))
                row = int(np.rint(pixels[keypoint, 1] + sine * offsets[j] + cosine * offsets[i]))
                if row < 0 or column < 0 or row >= height or column >= width or weights[row, column] == 0.0:
                    continue
                orientation, cell = index[row, column], (part[i] * cells + part[j]) * bins
                share = shares[orientation]
                histograms[keypoint, cell + lowers[orientation]] += weights[row, column] * (1.0 - share)
                histograms[keypoint, cell + uppers[orientation]] += weights[row, column] * share
    return histograms


@fast
def disc_histograms(layers: Array, pixels: NDArray[np.int64], disc: Array) -> Array:
    """Sums (n, layers) of each of `layers` (l, h, w) over a disc around each of `pixels` (n, 2), column and row.

    `disc` (d, d), d odd, holds the weights; what lies outside the layers counts nothing.
    """
    count, height, width = layers.shape
    radius = len(disc) // 2
    sums = np.zeros((len(pixels), count), dtype=np.float32)
    for keypoint in range(len(pixels)):
        left, top = pixels[keypoint, 0] - radius, pixels[keypoint, 1] - radius
        first, last = max(0, -left), min(len(disc), width - left)
        for layer in range(count):
            total = np.float32(0.0)
            for i in range(max(0, -top), min(len(disc), height - top)):
                weights, values = disc[i, first:last], layers[layer, top + i, left + first : left + last]
                for j in range(len(weights)):
                    total += weights[j] * values[j]
            sums[keypoint, layer] = total
    return sums
