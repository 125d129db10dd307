"""The kernels of description that a device may do in the place of the compiled ones.

They follow the steps of the method. Each call is of one submap, which is a batch by itself: a million returns, a
hundred thousand corners, sixteen filters. Requests and answers are NumPy arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # brings the compiler
    from revisit.core.kernels.point_columns import PointColumns

Array = NDArray[np.float32]
Array64 = NDArray[np.float64]


class Returns(NamedTuple):
    """Points (n, 3) float32 of several scans one after another; scan k is from row bounds[k] to before bounds[k + 1],
    seen from origins[k]: (s + 1,) int64 and (s, 3) float32.
    """

    points: Array
    bounds: NDArray[np.int64]
    origins: Array


@dataclass(frozen=True, eq=False)
class Planes:
    """Tangent planes: positions (n, 3) and unit normals (n, 3), float32, over voxels of edge `resolution` metres.

    Equal to itself alone, so that a device can remember what it made of it.
    """

    positions: Array
    normals: Array
    resolution: float

    @cached_property
    def columns(self) -> PointColumns:
        """The positions by the column of voxels that they lie in."""
        from revisit.core.kernels.point_columns import columns_of

        return columns_of(self.positions, self.resolution)


class FieldRules(NamedTuple):
    """Which planes count at a query: the `neighbours` nearest within `rings` voxels, by distance to the `power`."""

    neighbours: int
    rings: int
    power: float


class Cells(NamedTuple):
    """Corners (n, 3) int32 of voxels, and of each cell the rows (m, 8) int32 of its corners."""

    corners: NDArray[np.int32]
    cell_corners: NDArray[np.int32]


class Cases(NamedTuple):
    """Triangles (256, 5, 3) int8 of each case of marching cubes, and lower corner and axis (12, 2) int64 of edges."""

    triangles: NDArray[np.int8]
    edges: NDArray[np.int64]


class Mesh(NamedTuple):
    """Vertices (v, 3) float32, faces (f, 3) int32, and which cells (m,) change sign."""

    vertices: Array
    faces: NDArray[np.int32]
    crossing: NDArray[np.bool_]


class Patches(NamedTuple):
    """How patches are sampled: edge and step in pixels, parts along an edge, and orientations that are counted."""

    edge: int
    step: int
    cells: int
    bins: int


class MapKernels(Protocol):
    """From returns to neural points (paper III-B)."""

    def gather(self, returns: Returns, resolution: float, limit: int) -> Array64:
        """Records (m, RECORD) of at most `limit` voxels, as `kernels.gathered_returns.GatheredReturns` has them."""
        ...

    def orient(self, positions: Array, records: Array64, everywhere: Planes, gathered: Array64) -> Array:
        """Unit normals (m, 3) towards the sensor at `positions` (m, 3), whose own `records` are (m, RECORD).

        Of the returns in the 27 voxels around each: `gathered` (n, RECORD) at the positions of `everywhere` (n, 3),
        whose normals are not known yet.
        """
        ...

    def see_through(self, positions: Array, returns: Returns) -> NDArray[np.int32]:
        """How many scans (n,) looked through each of `positions` (n, 3), as `kernels.visibility` says."""
        ...


class SurfaceKernels(Protocol):
    """From neural points to their surface (paper III-C)."""

    def cells(self, planes: Planes, observed: float) -> Cells:
        """The voxels that a surface can pass, as `kernels.surface_cells.find_cells`; corners in any order."""
        ...

    def distances(self, queries: Array, planes: Planes, rules: FieldRules) -> tuple[Array, Array]:
        """Blended distances (m,) of `queries` (m, 3) to the planes, 0 where none is near; and distances (m,) to the
        nearest position, inf there.
        """
        ...

    def blended_normals(self, queries: Array, planes: Planes, rules: FieldRules) -> Array:
        """Blended unit normals (m, 3) at `queries` (m, 3), as `kernels.neighbour_blend.blend_normals`."""
        ...

    def polygonise(
        self, cell_corners: NDArray[np.int32], corners: Array, values: Array, cases: Cases, resolution: float
    ) -> Mesh:
        """Marching cubes of `values` (n,) at `corners` (n, 3) metres, as `kernels.marching_cubes.polygonise`."""
        ...

    def any_within(self, queries: Array, points: Array, distance: float) -> NDArray[np.bool_]:
        """Whether any of `points` (n, 3) lies within `distance` metres of each of `queries` (m, 3)."""
        ...


class ViewKernels(Protocol):
    """Counts of a place and filters of its plan (paper III-D, decision 0017)."""

    def strongest_orientations(self, image: Array, bank: Array) -> tuple[NDArray[np.int8], Array]:
        """Which orientation of the filters `bank` (o, s, k, k) answers strongest in the `image` (h, w), and how."""
        ...

    def discs(self, layers: Array, pixels: NDArray[np.int64], disc: Array) -> Array:
        """As `kernels.patch_histograms.disc_histograms`."""
        ...

    def patches(
        self, index: NDArray[np.int8], weights: Array, pixels: NDArray[np.int64], angles: Array, form: Patches
    ) -> Array:
        """As `kernels.patch_histograms.patch_histograms`."""
        ...

    def faces(
        self, vertices: Array64, heading: Array64, weight: Array64, shape: tuple[int, int], spacing: float,
        sharpness: float,
    ) -> Array64:  # fmt: skip
        """As `kernels.heading_profiles.face_profiles`, of shape (headings, bins)."""
        ...

    def plans(self, places: Array64, weight: Array64, shape: tuple[int, int], spacing: float) -> Array64:
        """As `kernels.heading_profiles.plan_profiles`, of shape (headings, bins)."""
        ...


@dataclass(frozen=True)
class DescriptionKernels:
    """The costly kernels of description, by the steps of the method."""

    maps: MapKernels
    surfaces: SurfaceKernels
    views: ViewKernels
