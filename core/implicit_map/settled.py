"""The geometry of neural points as it is stored: voxel, octahedral normal, plane offset, class of hits.

Fitting works on this geometry already (`settle`), so that storing a map loses nothing of it (docs/decisions/0287).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.neural_points import PlaneCodes
from revisit.core.geometry import octahedral
from revisit.core.implicit_map.neural_points import NeuralPoints
from revisit.core.kernels.plane_guesses import FIXED, HIT_CLASSES
from revisit.core.kernels.settled_planes import spots_on_planes
from revisit.core.kernels.voxel_table import distinct_rows

Array = NDArray[np.float32]

NORMAL_STEPS = 15
OFFSET_UNIT = 48
"""Parts of FIXED of a voxel's edge: 1.9 cm in voxels of 0.4 m."""

STORED_NORMAL_UNIT = 2
"""Steps of a normal by which it is stored: where none is learned on top, twelve degrees are as good as six."""


def settle(points: NeuralPoints, resolution: float) -> NeuralPoints:
    """Neural points moved along their tangent planes to the spot nearest the voxel centre, as they are stored.

    Where the mean of returns was rounded over the edge of a voxel into an occupied one, one of the two stays.
    """
    return settled_rows(points, resolution)[0]


def settled_rows(points: NeuralPoints, resolution: float) -> tuple[NeuralPoints, NDArray[np.int64]]:
    """As `settle`, and the rows (m,), ascending, of the `points` (n) that stayed."""
    codes = plane_codes(points, resolution)
    rows = distinct_rows(codes.voxels)
    if len(rows) < len(points):
        codes, points = codes[rows], points.subset(rows)
    positions, normals = geometry(codes, resolution)
    return dataclasses.replace(points, positions=positions, normals=normals), rows


def plane_codes(points: NeuralPoints, resolution: float) -> PlaneCodes:
    """The points as whole numbers."""
    voxels = np.floor(points.positions / resolution).astype(np.int32)
    codes = octahedral.encode(points.normals, NORMAL_STEPS)
    local = points.positions - (voxels + 0.5) * resolution
    offset = np.einsum("ij,ij->i", local, octahedral.decode(codes, NORMAL_STEPS)) / (resolution * OFFSET_UNIT / FIXED)
    hits = np.clip(np.log2(np.maximum(points.hits, 1)), 0, HIT_CLASSES - 1)
    return PlaneCodes(voxels, np.column_stack([codes, np.rint(offset), hits]).astype(np.int32))


def geometry(
    codes: PlaneCodes, resolution: float, normal_steps: int = NORMAL_STEPS, offset_unit: int = OFFSET_UNIT
) -> tuple[Array, Array]:
    """Positions and normals (n, 3): on the tangent plane, inside the voxel, near its centre."""
    normals = octahedral.decode(codes.planes[:, :2], normal_steps)
    heights = codes.planes[:, 2] * (resolution * offset_unit / FIXED)
    return on_planes(codes.voxels, normals, heights, resolution)


def on_planes(
    voxels: NDArray[np.int32], normals: NDArray[np.float64], heights: NDArray[np.floating], resolution: float
) -> tuple[Array, Array]:
    """The spots of `voxels` (n, 3) nearest their centres on planes `heights` (n,) metres along `normals` (n, 3)."""
    spots = spots_on_planes(voxels, np.ascontiguousarray(normals), heights.astype(np.float64), resolution)
    return spots, normals.astype(np.float32)


def hits_of(codes: PlaneCodes) -> NDArray[np.int32]:
    """The least number of scans in each point's class of hits: 1, 2, 4 or 8."""
    return np.asarray(1 << codes.planes[:, 3], dtype=np.int32)
