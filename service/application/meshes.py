"""Meshes: kept packed beside each submap, so that a download needs neither a worker nor the neural map's decoder."""

from __future__ import annotations

import struct

import numpy as np
import zstandard

from core.errors import DataLoss
from service.application.ports import Mesh

MESH_BLOB = "mesh"

_MAGIC = b"RVM1"
_HEADER = struct.Struct("<4sII")
_STEP_M = 0.001


def pack_mesh(mesh: Mesh) -> bytes:
    """Vertices on a 1 mm grid and faces, each as differences under zstd."""
    grid = np.round(mesh.vertices / _STEP_M).astype("<i4")
    vertices = np.diff(grid, axis=0, prepend=np.zeros((1, 3), dtype="<i4")).astype("<i4")
    faces = np.diff(mesh.faces.astype("<i4"), axis=0, prepend=np.zeros((1, 3), dtype="<i4")).astype("<i4")
    header = _HEADER.pack(_MAGIC, len(vertices), len(faces))
    planes = np.concatenate([vertices, faces]).T.copy().view(np.uint8).reshape(-1, 4).T
    return header + zstandard.ZstdCompressor(level=3).compress(planes.tobytes())


def unpack_mesh(blob: bytes) -> Mesh:
    """The mesh of `pack_mesh`, vertices within half a millimetre. Raises DataLoss for anything else."""
    try:
        magic, vertices, faces = _HEADER.unpack_from(blob)
        size = (vertices + faces) * 12
        if magic != _MAGIC:
            raise DataLoss("a stored mesh has a damaged header")
        data = zstandard.ZstdDecompressor().decompress(blob[_HEADER.size :], max_output_size=size) if size else b""
    except (struct.error, zstandard.ZstdError) as error:
        raise DataLoss("a stored mesh is damaged") from error
    if len(data) != size:
        raise DataLoss("a stored mesh is incomplete")
    rows = np.ascontiguousarray(np.frombuffer(data, dtype=np.uint8).reshape(4, -1).T).view("<i4").reshape(3, -1).T
    grid = np.cumsum(rows[:vertices], axis=0)
    return Mesh((grid * _STEP_M).astype(np.float32), np.cumsum(rows[vertices:], axis=0).astype(np.int32))


def mesh_ply(mesh: Mesh) -> bytes:
    """The mesh as a binary little-endian PLY file."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment Revisit submap, metres, submap frame\n"
        f"element vertex {len(mesh.vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    faces["count"] = 3
    faces["corners"] = mesh.faces
    return header.encode() + mesh.vertices.astype("<f4").tobytes() + faces.tobytes()
