"""The kernels of description of the processor: compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lab.gpu.kernels import (
    Array,
    Array64,
    Cases,
    Cells,
    DescriptionKernels,
    FieldRules,
    Mesh,
    Patches,
    Planes,
    Returns,
)
from revisit.core.bev.log_gabor import strongest_orientations
from revisit.core.kernels.elastic_points import VIEW, pooled_covariances
from revisit.core.kernels.gathered_returns import GatheredReturns
from revisit.core.kernels.heading_profiles import face_profiles, plan_profiles
from revisit.core.kernels.marching_cubes import polygonise
from revisit.core.kernels.nearest_points import any_within, nearest_points
from revisit.core.kernels.neighbour_blend import blend_normals
from revisit.core.kernels.oriented_normals import oriented_normals
from revisit.core.kernels.patch_histograms import disc_histograms, patch_histograms
from revisit.core.kernels.plane_distance import plane_distance
from revisit.core.kernels.point_columns import columns_of
from revisit.core.kernels.visibility import mark_seen_through, range_image
from revisit.core.surface.cells import cells_near_planes


def compiled_description() -> DescriptionKernels:
    """The kernels of description by the functions of `core.kernels`."""
    return DescriptionKernels(CompiledMaps(), CompiledSurfaces(), CompiledViews())


class CompiledMaps:
    """`MapKernels` by the functions of `core.kernels`."""

    def gather(self, returns: Returns, resolution: float, limit: int) -> Array64:
        """See `MapKernels`."""
        gathered = GatheredReturns(resolution, len(returns.points), limit)
        for scan, origin in enumerate(returns.origins):
            gathered.insert(returns.points[returns.bounds[scan] : returns.bounds[scan + 1]], origin, scan)
        return gathered.records

    def orient(self, positions: Array, records: Array64, everywhere: Planes, gathered: Array64) -> Array:
        """See `MapKernels`."""
        spreads = pooled_covariances(positions, gathered, everywhere.columns, everywhere.resolution)
        return oriented_normals(spreads, records[:, VIEW])

    def see_through(self, positions: Array, returns: Returns) -> NDArray[np.int32]:
        """See `MapKernels`."""
        counts = np.zeros(len(positions), dtype=np.int32)
        for scan, origin in enumerate(returns.origins):
            image = range_image(returns.points[returns.bounds[scan] : returns.bounds[scan + 1]], origin)
            mark_seen_through(positions, origin, image, counts)
        return counts


class CompiledSurfaces:
    """`SurfaceKernels` by the functions of `core.kernels`."""

    def cells(self, planes: Planes, observed: float) -> Cells:
        """See `SurfaceKernels`."""
        near = cells_near_planes(planes.positions, planes.normals, planes.resolution, observed)
        return Cells(near.corners, near.cell_corners)

    def distances(self, queries: Array, planes: Planes, rules: FieldRules) -> tuple[Array, Array]:
        """See `SurfaceKernels`."""
        indices, squared = nearest_points(queries, planes.columns, planes.resolution, rules.neighbours, rules.rings)
        distance = plane_distance(queries, planes.positions, planes.normals, indices, squared, rules.power)
        return distance, np.sqrt(squared[:, 0])

    def blended_normals(self, queries: Array, planes: Planes, rules: FieldRules) -> Array:
        """See `SurfaceKernels`."""
        near = nearest_points(queries, planes.columns, planes.resolution, rules.neighbours, rules.rings)
        return np.asarray(blend_normals(*near, planes.normals, rules.power))

    def polygonise(
        self, cell_corners: NDArray[np.int32], corners: Array, values: Array, cases: Cases, resolution: float
    ) -> Mesh:
        """See `SurfaceKernels`."""
        return Mesh(*polygonise(cell_corners, corners, values, *cases, resolution))

    def any_within(self, queries: Array, points: Array, distance: float) -> NDArray[np.bool_]:
        """See `SurfaceKernels`."""
        return any_within(queries, columns_of(points, distance), distance)


class CompiledViews:
    """`ViewKernels` by the functions of `core.kernels`."""

    def strongest_orientations(self, image: Array, bank: Array) -> tuple[NDArray[np.int8], Array]:
        """See `ViewKernels`."""
        return strongest_orientations(image, bank)

    def discs(self, layers: Array, pixels: NDArray[np.int64], disc: Array) -> Array:
        """See `ViewKernels`."""
        return np.asarray(disc_histograms(layers, pixels, disc))

    def patches(
        self, index: NDArray[np.int8], weights: Array, pixels: NDArray[np.int64], angles: Array, form: Patches
    ) -> Array:
        """See `ViewKernels`."""
        return np.asarray(patch_histograms(index, weights, pixels, angles, *form))

    def faces(
        self, vertices: Array64, heading: Array64, weight: Array64, shape: tuple[int, int], spacing: float,
        sharpness: float,
    ) -> Array64:  # fmt: skip
        """See `ViewKernels`."""
        return np.asarray(face_profiles(vertices, heading, weight, *shape, spacing, sharpness))

    def plans(self, places: Array64, weight: Array64, shape: tuple[int, int], spacing: float) -> Array64:
        """See `ViewKernels`."""
        return np.asarray(plan_profiles(places, weight, *shape, spacing))
