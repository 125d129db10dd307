"""Surface of a submap out of its implicit map: mesh vertices, normals and occupancy (paper III-C)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import ImplicitMapConfig, SurfaceConfig
from revisit.core.geometry.voxel_keys import voxel_keys
from revisit.core.implicit_map import NeuralMap
from revisit.core.implicit_map.fitting import accumulate
from revisit.core.kernels.cluster_joins import connected_parts
from revisit.core.kernels.marching_cubes import polygonise
from revisit.core.stages import stage
from revisit.core.submap import Submap
from revisit.core.surface.cells import cells_near_planes
from revisit.core.surface.marching_cubes import case_table, edge_table

Array = NDArray[np.float32]

__all__ = ["Surface", "extract_surface", "surface_from_points"]

_ON_CORNER_M = 1e-6
"""Nearer to the surface a voxel corner lies on it, on flat ground many do: the sign would be that of rounding alone."""


@dataclass(frozen=True)
class Surface:
    """Mesh and occupancy in the submap frame, metres.

    vertices (v, 3) float32; normals (v, 3) float32 unit, towards free space; faces (f, 3) int32, may be empty;
    occupied (o, 3) int32 voxel indices, voxel centre = (index + 0.5) * resolution; occupancy (o,) float32 evidence of
    each voxel; resolution the voxel edge.
    """

    vertices: Array
    normals: Array
    faces: NDArray[np.int32]
    occupied: NDArray[np.int32]
    occupancy: Array
    resolution: float


@stage("surface")
def extract_surface(neural_map: NeuralMap, config: SurfaceConfig) -> Surface:
    """Marching cubes on the voxel corners around the neural points, where the field was observed (paper III-C).

    Occupied are the voxels whose corners change sign; their evidence is 1. Vertices of small connected parts are
    dropped. The normal of a vertex is that of the neural points around it.
    """
    resolution = neural_map.config.resolution
    if len(neural_map.points) == 0:
        return _empty(resolution)
    points, reach = neural_map.points, neural_map.config.search_rings * resolution
    near = cells_near_planes(points.positions, points.normals, resolution, min(config.observed_distance, reach))
    corner_positions = (near.corners * resolution).astype(np.float32)
    values, nearest = neural_map.sdf(corner_positions)
    values[np.abs(values) < _ON_CORNER_M] = 0.0
    values[nearest > config.observed_distance] = np.nan
    vertices, faces, crossing = polygonise(
        near.cell_corners, corner_positions, values, case_table(), edge_table(), resolution
    )
    vertices, faces = _without_small_components(vertices, faces, config.min_component)
    occupied = near.cells[crossing]
    return Surface(
        vertices, neural_map.normals(vertices), faces, occupied, np.ones(len(occupied), np.float32), resolution
    )


@stage("surface")
def surface_from_points(submap: Submap, map_config: ImplicitMapConfig, config: SurfaceConfig) -> Surface:
    """The ablation without the implicit map: voxel counts and normals by PCA of each neighbourhood (paper IV-D)."""
    points = accumulate(submap, map_config)
    voxels = np.floor(submap.points / np.float32(map_config.resolution)).astype(np.int64)
    _, first, counts = np.unique(voxel_keys(voxels), return_index=True, return_counts=True)
    seen = counts >= config.min_returns
    occupied, occupancy = voxels[first[seen]].astype(np.int32), counts[seen].astype(np.float32)
    nothing = np.zeros((0, 3), np.int32)
    return Surface(points.positions, points.normals, nothing, occupied, occupancy, map_config.resolution)


def _without_small_components(
    vertices: Array, faces: NDArray[np.int32], smallest: int
) -> tuple[Array, NDArray[np.int32]]:
    """Drop the connected parts with fewer than `smallest` vertices: isolated outliers (paper III-C)."""
    if len(vertices) == 0:
        return vertices, faces
    part = connected_parts(len(vertices), faces)
    keep = (np.bincount(part, minlength=len(vertices)) >= smallest).take(part)
    renumbered = np.cumsum(keep, dtype=np.int32) - 1
    kept_faces = faces.take(np.flatnonzero(keep.take(faces[:, 0])), axis=0)
    return vertices.take(np.flatnonzero(keep), axis=0), renumbered.take(kept_faces)


def _empty(resolution: float) -> Surface:
    nothing = np.zeros((0, 3), np.float32)
    return Surface(
        nothing, nothing, np.zeros((0, 3), np.int32), np.zeros((0, 3), np.int32), np.zeros(0, np.float32), resolution
    )
