"""The neighbourhood of queries among the neural points, once per query set (paper Eq. 2-4).

Indices, weights and encodings do not depend on the latent features, so fitting computes them once and reuses them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import ImplicitMapConfig
from revisit.core.kernels.nearest_points import nearest_points
from revisit.core.kernels.neighbour_blend import blend_neighbours, tangent_frames
from revisit.core.kernels.point_columns import PointColumns

Array = NDArray[np.float32]


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
    queries: Array, positions: Array, normals: Array, columns: PointColumns, config: ImplicitMapConfig
) -> Neighbourhood:
    """The neighbourhood of `queries` (m, 3) among neural points at `positions` (n, 3) with `normals` (n, 3)."""
    indices, squared = nearest_points(queries, columns, config.resolution, config.neighbours, config.search_rings)
    weights, encoding, plane = blend_neighbours(
        queries, positions, tangent_frames(normals), indices, squared, config.weight_power, config.resolution
    )
    return Neighbourhood(np.maximum(indices, 0).astype(np.int64), weights, encoding, plane, np.sqrt(squared[:, 0]))
