"""The voxels around the neural points that a surface can pass, and their corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.surface_cells import enter_cells, enter_observed_corners
from revisit.core.kernels.voxel_table import VoxelTable, empty_slots

Array = NDArray[np.float32]
Voxels = NDArray[np.int32]

_CELLS_EACH = 4
_CORNERS_EACH = 8
"""Cells and corners that a neural point may add before its hash table becomes slow."""


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
    block = (2 * int(np.ceil(observed / resolution))) ** 3
    corners = _room_for(block * len(positions), _CORNERS_EACH * len(positions))
    count = enter_observed_corners(positions, resolution, observed, corners)
    found = _room_for(27 * len(positions), _CELLS_EACH * len(positions))
    cell_corners, cells = enter_cells(positions, normals, resolution, corners, found)
    return SurfaceCells(found.voxels[:cells].copy(), cell_corners[:cells].copy(), corners.voxels[:count].copy())


def _room_for(rows: int, expected: int) -> VoxelTable:
    """An empty table for up to `rows` voxels, of which `expected` are usual. Unused rows take no memory."""
    return VoxelTable(empty_slots(expected), np.empty(rows, np.int32), np.empty((rows, 3), np.int32))
