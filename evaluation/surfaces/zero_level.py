"""The surface where the field of a neural map is zero, as a mesh finer than its voxels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import SurfaceConfig
from revisit.core.geometry.voxel_keys import voxel_keys
from revisit.core.implicit_map import NeuralMap
from revisit.core.kernels.marching_cubes import polygonise
from revisit.core.surface.cells import cells_near_planes
from revisit.core.surface.marching_cubes import CORNERS, case_table, edge_table

Array = NDArray[np.float32]


@dataclass(frozen=True)
class Mesh:
    """vertices (v, 3) float32 metres in the frame of the map, faces (f, 3) int32."""

    vertices: Array
    faces: NDArray[np.int32]


def zero_level(field: NeuralMap, step: float, config: SurfaceConfig = SurfaceConfig()) -> Mesh:
    """The zero level where the field was observed, by marching cubes on cells of about `step` metres.

    The edge is shortened or lengthened so that it divides that of the map's voxels.
    """
    points, edge = field.points, field.config.resolution
    parts = max(1, round(edge / step))
    observed = min(max(config.observed_distance, 1.5 * edge), field.config.search_rings * edge)
    near = cells_near_planes(points.positions, points.normals, edge, observed).cells
    cells = _subdivided(_crossed(field, near, edge), parts)
    corners, cell_corners = _corners(cells)
    positions = (corners * (edge / parts)).astype(np.float32)
    values, nearest = field.sdf(positions)
    values[nearest > observed] = np.nan
    vertices, faces, _ = polygonise(cell_corners, positions, values, case_table(), edge_table(), edge / parts)
    return Mesh(vertices, faces)


def _crossed(field: NeuralMap, cells: NDArray[np.int32], edge: float) -> NDArray[np.int32]:
    """Those of `cells` (n, 3) that the zero level can pass: corners of both signs, or the middle near it."""
    corners, cell_corners = _corners(cells)
    solid = (field.sdf((corners * edge).astype(np.float32))[0] < 0)[cell_corners]
    mixed = np.asarray(solid.any(axis=1) & ~solid.all(axis=1))
    middle = np.abs(field.sdf(((cells[~mixed] + 0.5) * edge).astype(np.float32))[0]) < 0.3 * edge
    mixed[~mixed] = middle
    return cells[mixed]


def _subdivided(cells: NDArray[np.int32], parts: int) -> NDArray[np.int32]:
    """The cells (n * parts^3, 3) of a grid `parts` times as fine inside `cells` (n, 3)."""
    inner = np.stack(np.meshgrid(*[np.arange(parts)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray((cells[:, None] * parts + inner).reshape(-1, 3), dtype=np.int32)


def _corners(cells: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """The corners (c, 3) of `cells` (n, 3), and the row of each cell's eight corners (n, 8)."""
    every = (cells[:, None].astype(np.int64) + CORNERS).reshape(-1, 3)
    _, first, rows = np.unique(voxel_keys(every), return_index=True, return_inverse=True)
    return every[first], rows.reshape(-1, 8).astype(np.int32)
