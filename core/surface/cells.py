"""The voxels around the neural points that a surface can pass, and their corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.surface_cells import enter_cells, enter_corners
from revisit.core.kernels.voxel_table import VoxelTable, empty_slots

Array = NDArray[np.float32]
Voxels = NDArray[np.int32]

_CELLS_EACH = 8
"""Cells that a neural point usually adds; the hash table is laid out for so many."""


@dataclass(frozen=True)
class SurfaceCells:
    """Cells (m, 3) and corners (n, 3), voxel indices int32; cell_corners (m, 8) int32, each cell's rows of corners."""

    cells: Voxels
    cell_corners: NDArray[np.int32]
    corners: Voxels


def cells_near_planes(positions: Array, normals: Array, resolution: float) -> SurfaceCells:
    """Voxels among the 27 around each neural point whose centre is within 0.9 edges of its tangent plane.

    Memory grows with the number of `positions` (n, 3), not with the volume between them.
    """
    found = _room_for(27 * len(positions), _CELLS_EACH * len(positions))
    cells = found.voxels[: enter_cells(positions, normals, resolution, found)].copy()
    corners = _room_for(8 * len(cells), 2 * len(cells))
    cell_corners, count = enter_corners(cells, corners)
    return SurfaceCells(cells, cell_corners, corners.voxels[:count].copy())


def _room_for(rows: int, expected: int) -> VoxelTable:
    """An empty table for up to `rows` voxels, of which `expected` are usual. Unused rows take no memory."""
    return VoxelTable(empty_slots(expected), np.empty(rows, np.int32), np.empty((rows, 3), np.int32))
