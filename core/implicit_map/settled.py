"""The geometry of neural points as it is stored: voxel, octahedral normal, plane offset.

Fitting works on this geometry already (`settle`), so that storing a map loses nothing of it (docs/decisions/0002).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from core.implicit_map.neural_points import NeuralPoints

Array = NDArray[np.float32]
Codes = tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.uint8]]

_NORMAL_LEVELS = 127
_OFFSET_LEVELS = 63
_SETTLE_ROUNDS = 8


def settle(points: NeuralPoints, resolution: float) -> NeuralPoints:
    """Neural points moved along their tangent planes to the spot nearest the voxel centre, as they are stored."""
    positions, normals = geometry(geometry_codes(points, resolution), resolution)
    return dataclasses.replace(points, positions=positions, normals=normals)


def geometry_codes(points: NeuralPoints, resolution: float) -> Codes:
    """Voxels (n, 3) int32, octahedral normals (n, 2) uint8 and plane offsets (n,) uint8."""
    voxels = np.floor(points.positions / resolution).astype(np.int32)
    octahedral = _to_octahedral(points.normals)
    normals = _from_octahedral(octahedral)
    centres = (voxels + 0.5) * resolution
    reach = resolution * np.sqrt(3.0) / 2
    offset = np.einsum("ij,ij->i", points.positions - centres, normals) / reach
    codes = np.clip(np.rint((offset + 1) * 0.5 * _OFFSET_LEVELS), 0, _OFFSET_LEVELS).astype(np.uint8)
    return voxels, octahedral, codes


def geometry(codes: Codes, resolution: float) -> tuple[Array, Array]:
    """Positions and normals (n, 3): on the tangent plane, inside the voxel, near its centre."""
    voxels, octahedral, offsets = codes
    normals = _from_octahedral(octahedral)
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


def _to_octahedral(normals: Array) -> NDArray[np.uint8]:
    """Unit vectors (n, 3) on the octahedron's unfolded square, (n, 2) codes 0..126 (63 = 0)."""
    folded = normals / np.abs(normals).sum(axis=1, keepdims=True)
    flat = folded[:, :2].copy()
    below = folded[:, 2] < 0
    flat[below] = (1 - np.abs(folded[below][:, [1, 0]])) * np.where(folded[below, :2] >= 0, 1.0, -1.0)
    half = _NORMAL_LEVELS // 2
    return np.asarray(np.rint(flat * half) + half, dtype=np.uint8)


def _from_octahedral(codes: NDArray[np.uint8]) -> NDArray[np.float64]:
    """The inverse of `_to_octahedral`: unit vectors (n, 3)."""
    half = _NORMAL_LEVELS // 2
    flat = (codes.astype(np.float64) - half) / half
    z = 1 - np.abs(flat).sum(axis=1)
    fold = np.maximum(-z, 0)[:, None]
    normals = np.concatenate([flat - np.where(flat >= 0, 1.0, -1.0) * fold, z[:, None]], axis=1)
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))
