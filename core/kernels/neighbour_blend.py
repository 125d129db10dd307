"""Weights and encodings of the neural points around queries (paper Eq. 2-4)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

NEAREST_M = 1e-3
ENCODING_SIZE = 9


@numba.njit(cache=True, fastmath=True)
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
    weights = np.zeros((count, k), dtype=np.float32)
    encoding = np.zeros((count, ENCODING_SIZE), dtype=np.float32)
    plane = np.zeros(count, dtype=np.float32)
    quarter = np.float32(np.pi / 2 / resolution)
    inverse = np.float32(1.0 / resolution)
    for m in range(count):
        total = np.float32(0.0)
        for j in range(k):
            if indices[m, j] < 0:
                break
            distance = max(np.sqrt(squared[m, j]), np.float32(NEAREST_M))
            weights[m, j] = distance ** np.float32(-power)  # Eq. 3
            total += weights[m, j]
        for j in range(k):
            i = indices[m, j]
            if i < 0:
                break
            weights[m, j] /= total
            w = weights[m, j]
            for a in range(3):
                d = np.float32(0.0)
                for b in range(3):
                    d += frames[i, a, b] * (queries[m, b] - positions[i, b])  # Eq. 2
                encoding[m, a] += w * d * inverse  # Eq. 4, and the two lines below
                encoding[m, 3 + a] += w * np.sin(d * quarter)
                encoding[m, 6 + a] += w * np.cos(d * quarter)
                if a == 2:
                    plane[m] += w * d
    return weights, encoding, plane
