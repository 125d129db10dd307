"""Cluster-guided projection of the occupancy evidence onto the horizontal plane (paper III-E, Eq. 7-9)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.clusters import Clusters
from revisit.core.config import BevConfig, Normalisation
from revisit.core.kernels.nearest_points import any_within
from revisit.core.kernels.point_columns import columns_of
from revisit.core.surface import Surface

Array = NDArray[np.float32]
Flags = NDArray[np.bool_]


def image_size(resolution: float, config: BevConfig) -> int:
    """Pixels along each edge of the image; even, so that the submap origin lies between the two middle pixels."""
    return 2 * round(config.half_range / resolution)


def cluster_supported(surface: Surface, clusters: Clusters, config: BevConfig) -> Flags:
    """Which voxels (o,) lie within delta_c of a dominant cluster (Eq. 7, Eq. 8).

    Where the dominant clusters support less than `min_support` of the voxels off the ground (a sparse sensor, a small
    yard), every voxel within delta_c of a vertex that is not ground counts; where nothing stands, every voxel.
    """
    dominant, every = clusters.labels >= 0, np.ones(len(surface.occupied), dtype=bool)
    supported = _voxels_near(surface, dominant, every, config.cluster_distance)  # Eq. 8: of any cluster
    standing = supported | _voxels_near(surface, ~(clusters.ground | dominant), ~supported, config.cluster_distance)
    if not standing.any():
        return every
    return supported if supported.sum() >= config.min_support * standing.sum() else standing


def project(surface: Surface, voxels: Flags, config: BevConfig) -> Array:
    """The BEV image (H, W) in 0..1: the occupancy of the chosen voxels (o,) summed per column, normalised (Eq. 9).

    Row = y, column = x, pixel = voxel. eta is logarithmic and saturates at a quantile of the columns that are occupied,
    so that neither the number of returns nor a single tall structure sets the scale.
    """
    size = image_size(surface.resolution, config)
    rows = np.flatnonzero(voxels)
    x, y = surface.occupied.take(rows, axis=0)[:, :2].T + size // 2
    inside = (x >= 0) & (x < size) & (y >= 0) & (y < size)
    sums = np.bincount(y[inside] * size + x[inside], surface.occupancy[rows][inside], size * size)  # Eq. 9
    return normalise(sums.reshape(size, size).astype(np.float32), config)


def normalise(sums: Array, config: BevConfig) -> Array:
    """eta of Eq. 9: evidence (H, W) >= 0 to intensities 0..1."""
    occupied = sums > 0
    if not occupied.any():
        return np.zeros_like(sums)
    if config.normalisation is Normalisation.BINARY:
        return occupied.astype(np.float32)
    scaled = np.log1p(sums) if config.normalisation is Normalisation.LOG else sums
    saturation = np.quantile(scaled[occupied], config.saturation_quantile)
    return np.asarray(np.minimum(scaled / saturation, 1.0), dtype=np.float32)


def _voxels_near(surface: Surface, vertices: Flags, voxels: Flags, distance: float) -> Flags:
    """Which voxels (o,), of those chosen, have their centre within `distance` metres of a chosen vertex (v,)."""
    near = np.zeros(len(surface.occupied), dtype=bool)
    if vertices.any() and voxels.any():
        rows, points = np.flatnonzero(voxels), surface.vertices.take(np.flatnonzero(vertices), axis=0)
        centres = (surface.occupied.take(rows, axis=0) + np.float32(0.5)) * np.float32(surface.resolution)
        near[rows] = any_within(centres, columns_of(points, distance), distance)  # Eq. 7
    return near
