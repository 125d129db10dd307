"""The voxels around the neural points that a surface can pass, and their corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.surface_cells import enter_observed_corners, find_cells, list_corners, pieces_around

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
    pieces = pieces_around(positions, resolution, observed)
    count = enter_observed_corners(positions, resolution, observed, pieces)
    corners, first = list_corners(pieces, count)
    cell_corners = find_cells(positions, normals, resolution, pieces, first, len(corners))
    return SurfaceCells(corners[cell_corners[:, 0]], cell_corners, corners)
