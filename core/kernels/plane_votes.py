"""How many points agree with each of many planes: the inner loop of the search for the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import compiled

Array = NDArray[np.float64]


@compiled
def plane_scores(normals: Array, offsets: Array, points: Array, near: float, below: float) -> Array:
    """The share of `points` (n, 3) within `near` of each plane (h,), less twice the share farther than `below` behind.

    A plane is where `normals` (h, 3) @ point + `offsets` (h,) = 0; the normals are unit vectors.
    """
    x, y, z = points[:, 0].copy(), points[:, 1].copy(), points[:, 2].copy()
    scores = np.empty(len(normals))
    for h in range(len(normals)):
        nx, ny, nz, offset = normals[h, 0], normals[h, 1], normals[h, 2], offsets[h]
        on, behind = 0, 0
        for i in range(len(x)):
            height = nx * x[i] + ny * y[i] + nz * z[i] + offset
            on += abs(height) < near
            behind += height < -below
        scores[h] = on / len(x) - 2.0 * (behind / len(x))
    return scores
