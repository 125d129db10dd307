"""Weights and encodings of the neural points around queries (paper Eq. 2-4)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import compiled, fast

Array = NDArray[np.float32]

NEAREST_M = 1e-3
ENCODING_SIZE = 9

_SINE = (np.float32(-1.9515295891e-4), np.float32(8.3321608736e-3), np.float32(-1.6666654611e-1))
_COSINE = (np.float32(2.443315711809948e-5), np.float32(-1.388731625493765e-3), np.float32(4.166664568298827e-2))
_QUARTER = np.float32(np.pi / 2)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)


@fast
def blend_neighbours(
    queries: Array,
    positions: Array,
    frames: Array,
    indices: NDArray[np.int32],
    squared: Array,
    power: float,
    resolution: float,
) -> tuple[Array, Array, Array]:
    """Eq. 2-4 for the coordinates: weights (m, K), encoding (m, 9), plane distance (m,)."""
    count, k = indices.shape
    blends = np.zeros((count, k), dtype=np.float32)
    encoding = np.zeros((count, ENCODING_SIZE), dtype=np.float32)
    plane = np.zeros(count, dtype=np.float32)
    inverse = np.float32(1.0 / resolution)
    local, sines, cosines = np.zeros(3 * k, np.float32), np.zeros(3 * k, np.float32), np.zeros(3 * k, np.float32)
    weights = np.zeros(k, dtype=np.float32)
    for m in range(count):
        near = _weigh(indices, squared, m, power, weights)
        for j in range(near):
            i = indices[m, j]
            x, y, z = queries[m, 0] - positions[i, 0], queries[m, 1] - positions[i, 1], queries[m, 2] - positions[i, 2]
            for a in range(3):
                local[3 * j + a] = (frames[i, a, 0] * x + frames[i, a, 1] * y + frames[i, a, 2] * z) * inverse  # Eq. 2
        _quarter_waves(local, sines, cosines, 3 * near)
        for j in range(near):
            w = weights[j]
            blends[m, j] = w
            for a in range(3):
                encoding[m, a] += w * local[3 * j + a]  # Eq. 4, and the two lines below
                encoding[m, 3 + a] += w * sines[3 * j + a]
                encoding[m, 6 + a] += w * cosines[3 * j + a]
        plane[m] = encoding[m, 2] * np.float32(resolution)
    return blends, encoding, plane


@fast
def blend_normals(indices: NDArray[np.int32], squared: Array, normals: Array, power: float) -> Array:
    """The unit normals (m, 3) of the weighted means of `normals` (n, 3) over the neighbours; zero where there is none.

    `indices` and `squared` are those of `nearest_points`, the weights those of `blend_neighbours`.
    """
    blended = np.zeros((len(indices), 3), dtype=np.float32)
    weights = np.zeros(indices.shape[1], dtype=np.float32)
    for m in range(len(indices)):
        near = _weigh(indices, squared, m, power, weights)
        x, y, z = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for j in range(near):
            i, w = indices[m, j], weights[j]
            x, y, z = x + w * normals[i, 0], y + w * normals[i, 1], z + w * normals[i, 2]
        length = max(np.sqrt(x * x + y * y + z * z), np.float32(1e-9))
        blended[m, 0], blended[m, 1], blended[m, 2] = x / length, y / length, z / length
    return blended


@numba.njit(inline="always")
def _weigh(indices: NDArray[np.int32], squared: Array, m: int, power: float, weights: Array) -> int:
    """Eq. 3 for query m: weights (K,) of its neighbours, of sum 1. Returns how many there are."""
    near, total = 0, np.float32(0.0)
    while near < indices.shape[1] and indices[m, near] >= 0:
        distance = max(np.sqrt(squared[m, near]), np.float32(NEAREST_M))
        if power == 1.0 or power == 2.0:
            weights[near] = _ONE / (distance if power == 1.0 else distance * distance)  # Eq. 3
        else:
            weights[near] = distance ** np.float32(-power)
        total += weights[near]
        near += 1
    for j in range(near):
        weights[j] /= total
    return near


@numba.njit(inline="always")
def _quarter_waves(values: Array, sines: Array, cosines: Array, count: int) -> None:
    """Sine and cosine of pi / 2 times each of the first `count` values: reduced to an eighth of a turn, then series."""
    for e in range(count):
        quarter = np.floor(values[e] + _HALF)
        x = (values[e] - quarter) * _QUARTER
        turns = np.int32(quarter)
        z = x * x
        s = x + x * z * (_SINE[2] + z * (_SINE[1] + z * _SINE[0]))
        c = _ONE - _HALF * z + z * z * (_COSINE[2] + z * (_COSINE[1] + z * _COSINE[0]))
        odd = (turns & 1) == 1
        one, other = (c if odd else s), (s if odd else c)
        sines[e] = -one if (turns & 2) == 2 else one
        cosines[e] = -other if ((turns + 1) & 2) == 2 else other


@compiled
def tangent_frames(normals: Array) -> Array:
    """Rotations (n, 3, 3) into the local frames, as `decoder.orientations` says."""
    frames = np.empty((len(normals), 3, 3), dtype=np.float32)
    for i in range(len(normals)):
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        length = np.sqrt(ny * ny + nx * nx)
        tx, ty, tz = np.float32(1.0), np.float32(0.0), np.float32(0.0)
        if length > np.float32(1e-3):
            tx, ty = -ny / length, nx / length
        along = tx * nx + ty * ny
        tx, ty, tz = tx - along * nx, ty - along * ny, tz - along * nz
        length = np.sqrt(tx * tx + ty * ty + tz * tz)
        tx, ty, tz = tx / length, ty / length, tz / length
        frames[i, 0, 0], frames[i, 0, 1], frames[i, 0, 2] = tx, ty, tz
        frames[i, 1, 0], frames[i, 1, 1], frames[i, 1, 2] = ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx
        frames[i, 2, 0], frames[i, 2, 1], frames[i, 2, 2] = nx, ny, nz
    return frames
