"""Orientation histograms of rotated patches (paper III-D)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]


@numba.njit(cache=True)
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
    for keypoint in range(len(pixels)):
        cosine, sine = np.cos(angles[keypoint]), np.sin(angles[keypoint])
        turn = angles[keypoint] * bins / np.pi
        for i in range(0, patch, step):
            v = i + 0.5 * step - 0.5 * patch
            for j in range(0, patch, step):
                u = j + 0.5 * step - 0.5 * patch
                column = int(np.rint(pixels[keypoint, 0] + cosine * u - sine * v))
                row = int(np.rint(pixels[keypoint, 1] + sine * u + cosine * v))
                if row < 0 or column < 0 or row >= height or column >= width or weights[row, column] == 0.0:
                    continue
                relative = (index[row, column] - turn) % bins
                lower = int(relative)
                share = relative - lower
                cell = ((i * cells // patch) * cells + j * cells // patch) * bins
                histograms[keypoint, cell + lower % bins] += weights[row, column] * (1.0 - share)
                histograms[keypoint, cell + (lower + 1) % bins] += weights[row, column] * share
    return histograms
