"""The blended distance of queries to the tangent planes around them (paper Eq. 2-4, without encodings)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import fast
from revisit.core.kernels.neighbour_blend import NEAREST_M

Array = NDArray[np.float32]


@fast
def plane_distance(
    queries: Array, positions: Array, normals: Array, indices: NDArray[np.int32], squared: Array, power: float
) -> Array:
    """Signed distances (m,) of `queries` (m, 3) to the planes of their neighbours, weighted as in Eq. 3.

    `indices` and `squared` (m, K) come from `nearest_points`; without any neighbour the distance is 0.
    """
    out = np.zeros(len(queries), dtype=np.float32)
    for m in range(len(queries)):
        total, blended = np.float32(0.0), np.float32(0.0)
        for j in range(indices.shape[1]):
            i = indices[m, j]
            if i < 0:
                break
            # a power of 2 needs no root
            near = max(squared[m, j], np.float32(NEAREST_M * NEAREST_M))
            weight = np.float32(1.0) / near if power == 2.0 else near ** np.float32(-0.5 * power)
            height = np.float32(0.0)
            for axis in range(3):
                height += normals[i, axis] * (queries[m, axis] - positions[i, axis])
            total += weight
            blended += weight * height
        if total > 0.0:
            out[m] = blended / total
    return out
