"""The voxels around the neural points that a surface can pass, and their corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.surface_cells import enter_observed_corners, find_cells, list_corners
from revisit.core.kernels.voxel_table import VoxelTable, empty_slots

Array = NDArray[np.float32]
Voxels = NDArray[np.int32]

_PIECES_EACH = 2
"""Pieces of corners that a neural point may add before the hash table becomes slow."""


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
    room = 2 * (2 * int(np.ceil(observed / resolution))) ** 2 * len(positions)
    pieces, bits = _room_for(room, _PIECES_EACH * len(positions)), np.empty(room, np.uint64)
    count = enter_observed_corners(positions, resolution, observed, pieces, bits)
    voxels, first = list_corners(pieces, bits, count)
    cell_corners = find_cells(positions, normals, resolution, pieces, bits, first, len(voxels))
    return SurfaceCells(voxels[cell_corners[:, 0]], cell_corners, voxels)


def _room_for(rows: int, expected: int) -> VoxelTable:
    """An empty table for up to `rows` voxels, of which `expected` are usual. Unused rows take no memory."""
    return VoxelTable(empty_slots(expected), np.empty(rows, np.int32), np.empty((rows, 3), np.int32))
