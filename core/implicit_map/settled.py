"""The geometry of neural points as it is stored: voxel, octahedral normal, plane offset.

Fitting works on this geometry already (`settle`), so that storing a map loses nothing of it (docs/decisions/0002).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import octahedral
from revisit.core.implicit_map.neural_points import NeuralPoints

Array = NDArray[np.float32]
Codes = tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.uint8]]

_NORMAL_STEPS = 63
_OFFSET_LEVELS = 63
_SETTLE_ROUNDS = 8


def settle(points: NeuralPoints, resolution: float) -> NeuralPoints:
    """Neural points moved along their tangent planes to the spot nearest the voxel centre, as they are stored."""
    positions, normals = geometry(geometry_codes(points, resolution), resolution)
    return dataclasses.replace(points, positions=positions, normals=normals)


def geometry_codes(points: NeuralPoints, resolution: float) -> Codes:
    """Voxels (n, 3) int32, octahedral normals (n, 2) uint8 and plane offsets (n,) uint8."""
    voxels = np.floor(points.positions / resolution).astype(np.int32)
    codes_of_normals = octahedral.encode(points.normals, _NORMAL_STEPS)
    normals = octahedral.decode(codes_of_normals, _NORMAL_STEPS)
    centres = (voxels + 0.5) * resolution
    reach = resolution * np.sqrt(3.0) / 2
    offset = np.einsum("ij,ij->i", points.positions - centres, normals) / reach
    codes = np.clip(np.rint((offset + 1) * 0.5 * _OFFSET_LEVELS), 0, _OFFSET_LEVELS).astype(np.uint8)
    return voxels, codes_of_normals, codes


def geometry(codes: Codes, resolution: float) -> tuple[Array, Array]:
    """Positions and normals (n, 3): on the tangent plane, inside the voxel, near its centre."""
    voxels, codes_of_normals, offsets = codes
    normals = octahedral.decode(codes_of_normals, _NORMAL_STEPS)
    centres = (voxels + 0.5) * resolution
    reach = resolution * np.sqrt(3.0) / 2
    height = (offsets * (2.0 / _OFFSET_LEVELS) - 1.0) * reach
    inside = 0.499 * resolution
    local = normals * height[:, None]
    for _ in range(_SETTLE_ROUNDS):
        local = np.clip(local, -inside, inside)
        local += normals * (height - np.einsum("ij,ij->i", local, normals))[:, None]
    local = np.clip(local, -inside, inside)
    return (centres + local).astype(np.float32), normals.astype(np.float32)
