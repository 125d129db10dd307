"""Points on stored tangent planes, as near the centres of their voxels as they can be (docs/decisions/0287)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import compiled

Array64 = NDArray[np.float64]

_ROUNDS = 8
_INSIDE = 0.499


@compiled
def spots_on_planes(
    voxels: NDArray[np.int32], normals: Array64, heights: Array64, resolution: float
) -> NDArray[np.float32]:
    """The spots (n, 3) of `voxels` (n, 3) nearest their centres on planes `heights` (n,) metres along `normals` (n, 3).

    By turns a spot is moved into the voxel and onto the plane; in the end it lies inside.
    """
    spots = np.empty((len(voxels), 3), dtype=np.float32)
    inside = _INSIDE * resolution
    for i in range(len(voxels)):
        nx, ny, nz, height = normals[i, 0], normals[i, 1], normals[i, 2], heights[i]
        x, y, z = nx * height, ny * height, nz * height
        for _ in range(_ROUNDS):
            x, y, z = min(max(x, -inside), inside), min(max(y, -inside), inside), min(max(z, -inside), inside)
            gap = height - (x * nx + y * ny + z * nz)
            x, y, z = x + nx * gap, y + ny * gap, z + nz * gap
        spots[i, 0] = (voxels[i, 0] + 0.5) * resolution + min(max(x, -inside), inside)
        spots[i, 1] = (voxels[i, 1] + 0.5) * resolution + min(max(y, -inside), inside)
        spots[i, 2] = (voxels[i, 2] + 0.5) * resolution + min(max(z, -inside), inside)
    return spots
