"""Dominant 3D clusters of a surface: ground removal and fast Euclidean clustering (paper III-C)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import ClusterConfig
from revisit.core.kernels.cluster_joins import join_cells
from revisit.core.kernels.point_columns import columns_of
from revisit.core.stages import stage
from revisit.core.surface import Surface

Array = NDArray[np.float32]


@dataclass(frozen=True)
class Clusters:
    """Dominant clusters C_1..C_M of a surface.

    labels (v,) int32 of each surface vertex: -1 for ground or minor parts, else 0..count-1 by decreasing size;
    ground (v,) which vertices are ground.
    """

    labels: NDArray[np.int32]
    count: int
    ground: NDArray[np.bool_]


@stage("clusters")
def segment_clusters(surface: Surface, config: ClusterConfig) -> Clusters:
    """Remove the ground, join vertices nearer than the radius, keep the parts that are large enough (paper III-C)."""
    ground = find_ground(surface, config)
    rows = np.flatnonzero(~ground)
    labels = np.full(len(surface.vertices), -1, dtype=np.int32)
    if len(rows) == 0:
        return Clusters(labels, 0, ground)
    parts = euclidean_clusters(surface.vertices.take(rows, axis=0), config.radius)
    sizes = np.bincount(parts)
    dominant = [part for part in np.argsort(-sizes, kind="stable") if sizes[part] >= config.min_vertices]
    renumbered = np.full(len(sizes), -1, dtype=np.int32)
    renumbered[dominant] = np.arange(len(dominant))
    labels[rows] = renumbered[parts]
    return Clusters(labels, len(dominant), ground)


def find_ground(surface: Surface, config: ClusterConfig) -> NDArray[np.bool_]:
    """Vertices (v,) of the ground: level and near the lower envelope of their column, or in a low and flat column.

    The second rule is for the far rings of a spinning sensor: one beam draws a line on the ground, whose normal says
    nothing, but nothing stands in its column either. Low is meant from the plane of the ground by the first rule.
    """
    vertices = surface.vertices
    if len(vertices) == 0:
        return np.zeros(0, dtype=bool)
    lowest, highest = _column_extents(vertices, config.ground_cell)
    level = np.abs(surface.normals[:, 2]) > config.ground_cosine
    ground = level & (vertices[:, 2] - lowest <= config.ground_height)
    above = vertices[:, 2] - _plane_height(vertices, ground)
    reach = np.hypot(vertices[:, 0], vertices[:, 1])
    flat = highest - lowest < config.standing_height
    return np.asarray(ground | (flat & (above < config.standing_height + config.ground_slope * reach)))


def _column_extents(vertices: Array, cell: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The lowest and the highest z (v,) in the vertical column of edge `cell` metres that each vertex is in."""
    columns = columns_of(vertices, cell)
    starts = np.flatnonzero(np.diff(columns.keys, prepend=-1))
    counts = np.diff(np.append(starts, len(vertices)))
    extents = np.empty((2, len(vertices)))
    extents[0, columns.rows] = np.repeat(np.minimum.reduceat(columns.points[:, 2], starts), counts)
    extents[1, columns.rows] = np.repeat(np.maximum.reduceat(columns.points[:, 2], starts), counts)
    return extents[0], extents[1]


def _plane_height(vertices: Array, ground: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Height (v,) below or above each vertex of the least-squares plane of the ground, or of the low vertices."""
    if ground.sum() < 10:
        return np.full(len(vertices), np.percentile(vertices[:, 2], 5.0))
    design = np.column_stack([vertices[:, :2], np.ones(len(vertices))]).astype(np.float64)
    rows = np.flatnonzero(ground)
    plane, *_ = np.linalg.lstsq(design.take(rows, axis=0), vertices[rows, 2].astype(np.float64))
    return np.asarray(design @ plane)


def euclidean_clusters(points: Array, radius: float) -> NDArray[np.int64]:
    """Connected components (n,) of the graph that joins points (n, 3) nearer than `radius` metres, numbered from 0.

    Exact. Cells of edge radius / sqrt(3) hold points that are joined anyway; only pairs of cells are searched.
    """
    edge = radius / np.sqrt(3.0)
    columns = columns_of(np.ascontiguousarray(points), edge)
    labels = np.empty(len(points), dtype=np.int64)
    first_cells = join_cells(columns, edge, radius)
    named = np.zeros(len(points), dtype=np.int64)
    named[first_cells] = 1
    labels[columns.rows] = (np.cumsum(named) - 1)[first_cells]
    return labels
