"""Meshes as binary glTF 2.0 (GLB): one file that viewers, browsers and game engines open.

glTF measures in metres and has y up; points come with z up and are turned.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField

MEDIA_TYPE = "model/gltf-binary"

_MAGIC, _VERSION = 0x46546C67, 2
_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_FLOAT, _UNSIGNED = 5126, 5125
_VERTICES, _INDICES = 34962, 34963


def encode_mesh(vertices: NDArray[np.floating], normals: NDArray[np.floating], faces: NDArray[np.integer]) -> bytes:
    """A GLB file of a mesh: vertices (v, 3) metres with z up, unit normals (v, 3), faces (f, 3) of vertex indices.

    Raises BadField for other shapes, for numbers that are not finite or an index outside of the vertices, and for a
    mesh without faces, which glTF cannot hold.
    """
    positions, directions = _y_up(vertices, "vertices"), _y_up(normals, "normals")
    triangles = np.ascontiguousarray(faces, dtype="<u4")
    if positions.shape != directions.shape or faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise BadField("a mesh needs as many normals as vertices, and faces (f, 3)", field="faces")
    if not 0 <= int(faces.min()) <= int(faces.max()) < len(positions):
        raise BadField("a face names a vertex that does not exist", field="faces")
    parts = [positions.tobytes(), directions.tobytes(), triangles.tobytes()]
    description = json.dumps(_description(positions, len(triangles), parts), separators=(",", ":")).encode()
    chunks = _chunk(_JSON, description, b" ") + _chunk(_BINARY, b"".join(parts), b"\0")
    return struct.pack("<III", _MAGIC, _VERSION, 12 + len(chunks)) + chunks


def _y_up(vectors: NDArray[np.floating], field: str) -> NDArray[np.float32]:
    """Vectors (n, 3) with z up as float32 with y up: (x, z, -y)."""
    if vectors.ndim != 2 or vectors.shape[1] != 3 or not np.isfinite(vectors).all():
        raise BadField(f"{field} must be (n, 3) and finite", field=field)
    return np.ascontiguousarray(np.stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]], axis=1), dtype="<f4")


def _description(positions: NDArray[np.float32], triangles: int, parts: list[bytes]) -> dict[str, Any]:
    """The JSON of a scene with one node, one mesh and one buffer in three parts: positions, normals, indices."""
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    targets = (_VERTICES, _VERTICES, _INDICES)
    vectors = {"componentType": _FLOAT, "count": len(positions), "type": "VEC3"}
    limits = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    indices = {"bufferView": 2, "componentType": _UNSIGNED, "count": 3 * triangles, "type": "SCALAR"}
    return {
        "asset": {"version": "2.0", "generator": "revisit"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2}]}],
        "accessors": [{"bufferView": 0, **vectors, **limits}, {"bufferView": 1, **vectors}, indices],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(part), "target": target}
            for start, part, target in zip(starts, parts, targets, strict=False)
        ],
        "buffers": [{"byteLength": starts[-1]}],
    }


def _chunk(kind: int, data: bytes, filler: bytes) -> bytes:
    data += filler * (-len(data) % 4)
    return struct.pack("<II", len(data), kind) + data
