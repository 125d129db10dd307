"""Meshes and points of tiles as they are stored: on a grid of a millimetre, as differences, compressed."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
import zstandard
from numpy.typing import NDArray

from revisit.core.codec.container import decompressed, from_byte_planes, to_byte_planes
from revisit.core.errors import DataLoss

_MAGIC = b"RVM1"
_HEADER = struct.Struct("<4sII")
_STEP_M = 0.001
_NORMAL_STEPS = 127
_MAX_BYTES = 2**29


@dataclass(frozen=True)
class Mesh:
    """Triangles: vertices (v, 3) float32 metres in the submap frame, unit normals (v, 3), faces (f, 3) int32."""

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    faces: NDArray[np.int32]


def pack_mesh(mesh: Mesh) -> bytes:
    """Vertices on a 1 mm grid, normals in 1/127 steps, and faces, as differences under zstd."""
    grid = np.round(mesh.vertices / _STEP_M).astype("<i4")
    rows = np.concatenate([_differences(grid), _differences(mesh.faces.astype("<i4"))])
    normals = np.round(mesh.normals * _NORMAL_STEPS).astype(np.int8)
    header = _HEADER.pack(_MAGIC, len(mesh.vertices), len(mesh.faces))
    return header + zstandard.ZstdCompressor(level=3).compress(to_byte_planes(rows) + normals.T.tobytes())


def unpack_mesh(blob: bytes) -> Mesh:
    """The mesh of `pack_mesh`: vertices within half a millimetre, normals within 0.01. Raises DataLoss for damage."""
    try:
        magic, vertices, faces = _HEADER.unpack_from(blob)
        rows_size = (vertices + faces) * 12
        size = rows_size + vertices * 3
        if magic != _MAGIC or size > _MAX_BYTES:
            raise DataLoss("a stored mesh has a damaged header")
    except struct.error as error:
        raise DataLoss("a stored mesh is damaged") from error
    data = decompressed(blob[_HEADER.size :], size, "stored mesh") if size else b""
    if len(data) != size:
        raise DataLoss("a stored mesh is incomplete")
    rows = from_byte_planes(data[:rows_size], 3, "<i4")
    normals = np.frombuffer(data, dtype=np.int8, offset=rows_size).reshape(3, -1).T
    return Mesh(
        vertices=(np.cumsum(rows[:vertices], axis=0) * _STEP_M).astype(np.float32),
        normals=(normals / _NORMAL_STEPS).astype(np.float32),
        faces=np.cumsum(rows[vertices:], axis=0).astype(np.int32),
    )


def _differences(rows: NDArray[np.int32]) -> NDArray[np.int32]:
    """Each row minus the one before it; int32 arithmetic wraps around and back."""
    return np.diff(rows, axis=0, prepend=np.zeros((1, 3), dtype="<i4")).astype("<i4")
