"""Meshes as binary glTF 2.0 (GLB): one file that viewers, browsers and game engines open.

glTF measures in metres and has y up; points come with z up and are turned. `encode_mesh` needs nothing beyond glTF;
`encode_scene` is for transport, with EXT_meshopt_compression a tenth as large.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField, MalformedBody

MEDIA_TYPE = "model/gltf-binary"

_MAGIC, _VERSION = 0x46546C67, 2
_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_FLOAT, _UNSIGNED, _SHORT = 5126, 5125, 5123
_VERTICES, _INDICES = 34962, 34963
_MESHOPT, _QUANTIZATION = "EXT_meshopt_compression", "KHR_mesh_quantization"
_HEAD: dict[str, Any] = {"asset": {"version": "2.0", "generator": "revisit"}, "scene": 0}


def encode_mesh(vertices: NDArray[np.floating], normals: NDArray[np.floating], faces: NDArray[np.integer]) -> bytes:
    """A GLB file of a mesh: vertices (v, 3) metres with z up, unit normals (v, 3), faces (f, 3) of vertex indices.

    Vertices are told from the middle of the mesh, which its node is moved to, so that float32 holds them. Raises
    BadField for other shapes, for numbers that are not finite or an index outside of the vertices, and for a mesh
    without faces, which glTF cannot hold.
    """
    middle = _middle(vertices)
    positions, directions = _y_up(vertices - middle, "vertices"), _y_up(normals, "normals")
    triangles = np.ascontiguousarray(faces, dtype="<u4")
    if positions.shape != directions.shape or faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise BadField("a mesh needs as many normals as vertices, and faces (f, 3)", field="faces")
    if not 0 <= int(faces.min()) <= int(faces.max()) < len(positions):
        raise BadField("a face names a vertex that does not exist", field="faces")
    parts = [positions.tobytes(), directions.tobytes(), triangles.tobytes()]
    return _file(_description(positions, len(triangles), parts, middle), b"".join(parts))


def encode_scene(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], offset_m: NDArray[np.floating] = np.zeros(3)
) -> bytes:
    """A GLB file of a mesh, compressed with meshopt: vertices (v, 3) metres from `offset_m` (3,), faces (f, 3).

    Positions are rounded to a twenty-fifth of a mean edge; there are no normals, which a viewer computes. A mesh
    without faces gives a scene without nodes. Raises BadField as `encode_mesh`.
    """
    _y_up(vertices, "vertices")
    if not len(faces):
        return _file({**_HEAD, "scenes": [{}]}, b"")
    if not 0 <= int(faces.min()) <= int(faces.max()) < len(vertices):
        raise BadField("a face names a vertex that does not exist", field="faces")
    from revisit.formats.meshopt import along_edges, encode_attributes, encode_triangles, in_order_of_use

    ordered, triangles = in_order_of_use(vertices, along_edges(faces))
    low, step = ordered.min(axis=0), _step(ordered, triangles)
    rows = np.zeros((len(ordered), 4), dtype="<u2")
    rows[:, :3] = np.rint((ordered - low) / step)
    parts = [encode_attributes(rows.view(np.uint8)), encode_triangles(triangles)]
    return _file(_compressed(rows[:, :3], 3 * len(triangles), parts, _node(low + offset_m, step)), b"".join(parts))


@dataclass(frozen=True)
class Bounds:
    """A box: its lowest and its highest corner (3,), metres, z up."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


def bounds_of_scene(data: bytes) -> Bounds | None:
    """The box of a file that `encode_scene` wrote; None for one without a mesh. Raises MalformedBody."""
    try:
        (length,) = struct.unpack_from("<I", data, 12)
        scene = json.loads(data[20 : 20 + length])
        if not scene.get("nodes"):
            return None
        (x, z, minus_y), (step, *_) = scene["nodes"][0]["translation"], scene["nodes"][0]["scale"]
        along, across, up = (step * value for value in scene["accessors"][0]["max"])
    except (struct.error, ValueError, KeyError, IndexError, TypeError) as error:
        raise MalformedBody("the GLB file is none of a tile") from error
    return Bounds((x, -minus_y, z), (x + along, across - minus_y, z + up))


def _step(vertices: NDArray[np.floating], faces: NDArray[np.int64]) -> float:
    """The step of positions, metres."""
    edges = np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1)
    return max(float(edges.mean()) / 25.0, float(np.ptp(vertices, axis=0).max()) / 65535.0, 1e-6)


def _node(low: NDArray[np.floating], step: float) -> dict[str, Any]:
    """Where whole numbers lie that were counted in steps from `low`, z up: turned about x by a right angle."""
    x, y, z = (float(value) for value in low)
    half = float(np.sqrt(0.5))
    return {"mesh": 0, "translation": [x, z, -y], "rotation": [-half, 0.0, 0.0, half], "scale": [step] * 3}


def _compressed(rows: NDArray[np.uint16], indices: int, parts: list[bytes], node: dict[str, Any]) -> dict[str, Any]:
    """The JSON of a scene whose two buffer views, of positions and of indices, are compressed."""
    short = len(rows) <= 65535
    kinds = (("ATTRIBUTES", len(rows), 8, _VERTICES), ("TRIANGLES", indices, 2 if short else 4, _INDICES))
    views, starts, whole = [], [0, len(parts[0])], 0
    for (mode, count, stride, target), start, part in zip(kinds, starts, parts, strict=True):
        packed = {"buffer": 0, "byteOffset": start, "byteLength": len(part), "byteStride": stride}
        view = {"buffer": 1, "byteOffset": whole, "byteLength": count * stride, "target": target}
        strided = {"byteStride": stride} if target == _VERTICES else {}
        views.append({**view, **strided, "extensions": {_MESHOPT: {**packed, "count": count, "mode": mode}}})
        whole += count * stride
    limits = {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
    return {
        **_HEAD,
        "extensionsUsed": [_MESHOPT, _QUANTIZATION],
        "extensionsRequired": [_MESHOPT, _QUANTIZATION],
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": _SHORT, "count": len(rows), "type": "VEC3", **limits},
            {"bufferView": 1, "componentType": _SHORT if short else _UNSIGNED, "count": indices, "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [
            {"byteLength": sum(map(len, parts))},
            {"byteLength": whole, "extensions": {_MESHOPT: {"fallback": True}}},
        ],
    }


def _file(description: dict[str, Any], binary: bytes) -> bytes:
    """A GLB file of its JSON and its bytes."""
    text = json.dumps(description, separators=(",", ":")).encode()
    chunks = _chunk(_JSON, text, b" ") + (_chunk(_BINARY, binary, b"\0") if binary else b"")
    return struct.pack("<III", _MAGIC, _VERSION, 12 + len(chunks)) + chunks


def _y_up(vectors: NDArray[np.floating], field: str) -> NDArray[np.float32]:
    """Vectors (n, 3) with z up as float32 with y up: (x, z, -y)."""
    if vectors.ndim != 2 or vectors.shape[1] != 3 or not np.isfinite(vectors).all():
        raise BadField(f"{field} must be (n, 3) and finite", field=field)
    return np.ascontiguousarray(np.stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]], axis=1), dtype="<f4")


def _middle(vertices: NDArray[np.floating]) -> NDArray[np.float64]:
    """A whole number of metres (3,) near the middle of vertices (v, 3); the origin where they have none."""
    if vertices.ndim != 2 or not len(vertices) or not np.isfinite(vertices).all():
        return np.zeros(vertices.shape[-1:])
    return np.rint(np.mean([vertices.min(axis=0), vertices.max(axis=0)], axis=0, dtype=np.float64))


def _description(
    positions: NDArray[np.float32], triangles: int, parts: list[bytes], middle: NDArray[np.float64]
) -> dict[str, Any]:
    """The JSON of a scene with one node, one mesh and one buffer in three parts: positions, normals, indices.

    Positions are told from `middle` (3,), metres with z up.
    """
    x, y, z = middle.tolist()
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    targets = (_VERTICES, _VERTICES, _INDICES)
    vectors = {"componentType": _FLOAT, "count": len(positions), "type": "VEC3"}
    limits = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    indices = {"bufferView": 2, "componentType": _UNSIGNED, "count": 3 * triangles, "type": "SCALAR"}
    return {
        **_HEAD,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "translation": [x, z, -y]}],
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
