"""The neighbourhood of queries among the neural points, once per query set (paper Eq. 2-4).

Indices, weights and encodings do not depend on the latent features, so fitting computes them once and reuses them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.config import ImplicitMapConfig
from revisit.core.implicit_map import voxel_hash
from revisit.core.implicit_map.decoder import ENCODING_SIZE, orientations

Array = NDArray[np.float32]

_NEAREST_M = 1e-3


@dataclass(frozen=True)
class Neighbourhood:
    """For m queries: indices (m, K) int64 (0 where missing), weights (m, K) of Eq. 3 (0 where missing),
    encoding (m, 9) g of Eq. 4, plane_distance (m,) metres, and nearest (m,) metres to the nearest neural point
    (inf where there is none).
    """

    indices: NDArray[np.int64]
    weights: Array
    encoding: Array
    plane_distance: Array
    nearest: Array

    def __getitem__(self, rows: NDArray[np.int64]) -> Neighbourhood:
        return Neighbourhood(
            self.indices[rows], self.weights[rows], self.encoding[rows], self.plane_distance[rows], self.nearest[rows]
        )


def find_neighbourhood(
    queries: Array, positions: Array, normals: Array, slots: NDArray[np.int32], config: ImplicitMapConfig
) -> Neighbourhood:
    """The neighbourhood of `queries` (m, 3) among neural points at `positions` (n, 3) with `normals` (n, 3)."""
    indices, squared = voxel_hash.nearest(
        queries, positions, slots, config.resolution, config.neighbours, config.search_rings
    )
    weights, encoding, plane = _blend(
        queries, positions, orientations(normals), indices, squared, config.weight_power, config.resolution
    )
    return Neighbourhood(np.maximum(indices, 0).astype(np.int64), weights, encoding, plane, np.sqrt(squared[:, 0]))


@numba.njit(cache=True, fastmath=True)
def _blend(
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
            distance = max(np.sqrt(squared[m, j]), np.float32(_NEAREST_M))
            # Eq. 3: inverse-distance weights
            weights[m, j] = distance ** np.float32(-power)
            total += weights[m, j]
        for j in range(k):
            i = indices[m, j]
            if i < 0:
                break
            weights[m, j] /= total
            w = weights[m, j]
            for a in range(3):
                # Eq. 2: the query in the frame of the neural point
                d = np.float32(0.0)
                for b in range(3):
                    d += frames[i, a, b] * (queries[m, b] - positions[i, b])
                encoding[m, a] += w * d * inverse
                encoding[m, 3 + a] += w * np.sin(d * quarter)
                encoding[m, 6 + a] += w * np.cos(d * quarter)
                if a == 2:
                    plane[m] += w * d
    return weights, encoding, plane
