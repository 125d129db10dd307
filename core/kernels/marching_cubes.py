"""Marching cubes over scattered cells (paper III-C)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import compiled

Array = NDArray[np.float32]


@compiled
def polygonise(
    cell_corners: NDArray[np.int32],
    corner_positions: Array,
    values: Array,
    table: NDArray[np.int8],
    edges: NDArray[np.int64],
    resolution: float,
) -> tuple[Array, NDArray[np.int32], NDArray[np.bool_]]:
    """Mesh of the zero level of `values` (n,) at `corner_positions` (n, 3) in cells (m, 8) of corner indices.

    A cell with a NaN corner has no surface. Returns vertices (v, 3), faces (f, 3) and which cells change sign (m,).
    """
    vertex_of_edge = np.full((len(values), 3), -1, dtype=np.int32)
    vertices = np.empty((3 * len(values), 3), dtype=np.float32)
    faces = np.empty((5 * len(cell_corners), 3), dtype=np.int32)
    crossing = np.zeros(len(cell_corners), dtype=np.bool_)
    vertex_count, face_count = 0, 0
    for m in range(len(cell_corners)):
        case, known = 0, True
        for c in range(8):
            value = values[cell_corners[m, c]]
            if np.isnan(value):
                known = False
            elif value < 0:
                case |= 1 << c
        if not known or case == 0 or case == 255:
            continue
        crossing[m] = True
        for t in range(5):
            if table[case, t, 0] < 0:
                break
            for k in range(3):
                low, axis = edges[table[case, t, k], 0], edges[table[case, t, k], 1]
                a, b = cell_corners[m, low], cell_corners[m, low | (1 << axis)]
                if vertex_of_edge[a, axis] < 0:
                    share = values[a] / (values[a] - values[b])
                    for along in range(3):
                        vertices[vertex_count, along] = corner_positions[a, along]
                    vertices[vertex_count, axis] += share * resolution
                    vertex_of_edge[a, axis] = vertex_count
                    vertex_count += 1
                faces[face_count, k] = vertex_of_edge[a, axis]
            face_count += 1
    return vertices[:vertex_count].copy(), faces[:face_count].copy(), crossing
