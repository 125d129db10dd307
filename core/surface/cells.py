"""The voxels around the neural points that a surface can pass, and their corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.device import device
from revisit.core.device.description import Planes

Array = NDArray[np.float32]
Voxels = NDArray[np.int32]


@dataclass(frozen=True)
class SurfaceCells:
    """Cells (m, 3) and corners (n, 3), voxel indices int32; cell_corners (m, 8) int32, each cell's rows of corners."""

    cells: Voxels
    cell_corners: NDArray[np.int32]
    corners: Voxels


def cells_near_planes(positions: Array, normals: Array, resolution: float, observed: float) -> SurfaceCells:
    """Voxels among the 27 around each neural point whose centre is within 0.9 edges of its tangent plane.

    Only those whose corners all lie within `observed` metres of a neural point: elsewhere the field says nothing.
    Memory grows with the number of `positions` (n, 3), not with the volume between them.
    """
    corners, cell_corners = device().description.surfaces.cells(Planes(positions, normals, resolution), observed)
    return SurfaceCells(corners[cell_corners[:, 0]], cell_corners, corners)
