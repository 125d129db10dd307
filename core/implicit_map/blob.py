"""The compact stored form of a neural map, versioned and checked.

A neural point is kept as its voxel, its normal (octahedral, 2 x 7 bits) and the offset of its tangent plane from the
voxel centre (6 bits). Fitting already works on this geometry (`settle`), so storing it loses nothing; the latent
features are rounded to multiples of FEATURE_STEP. Per scan times are reduced to those of the session part.
"""

from __future__ import annotations

import hashlib
import json
import struct

import numpy as np
import zstandard
from numpy.typing import NDArray

from core.config import ImplicitMapConfig
from core.errors import DataLoss, DescriptorModelMismatch
from core.implicit_map.decoder import DecoderWeights
from core.implicit_map.neural_map import NeuralMap
from core.implicit_map.neural_points import NeuralPoints

Array = NDArray[np.float32]
Codes = tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.uint8]]

MAGIC = b"RVNM\x01"
FEATURE_STEP = 0.08
_NORMAL_LEVELS = 127
_OFFSET_LEVELS = 63
_MAX_POINTS = 4_000_000
_SETTLE_ROUNDS = 8


def settle(points: NeuralPoints, resolution: float) -> NeuralPoints:
    """Neural points moved along their tangent planes to the spot nearest the voxel centre, as they are stored."""
    codes = _geometry_codes(points, resolution)
    positions, normals = _geometry(codes, resolution)
    return NeuralPoints(positions, normals, points.created, points.updated, points.hits, points.stability)


def to_blob(neural_map: NeuralMap) -> bytes:
    """The neural map as bytes: header, zstd body, SHA-256 over both."""
    points, resolution = neural_map.points, neural_map.config.resolution
    voxels, octahedral, offsets = _geometry_codes(points, resolution)
    order = np.lexsort((voxels[:, 2], voxels[:, 1], voxels[:, 0]))
    features = np.clip(np.rint(neural_map.features[order] / FEATURE_STEP), -127, 127).astype(np.int8)
    sections = [
        *(_varint(np.diff(voxels[order, axis], prepend=0)) for axis in range(3)),
        octahedral[order].T.tobytes(),
        offsets[order].tobytes(),
        np.clip(points.hits[order], 0, 255).astype(np.uint8).tobytes(),
        features.T.tobytes(),
    ]
    header = {
        "count": len(points), "features": int(features.shape[1]), "resolution": resolution,
        "decoder": neural_map.decoder.digest, "sections": [len(section) for section in sections],
        "stamps_ns": [int(stamp) for stamp in neural_map.stamps_ns],
    }  # fmt: skip
    head = json.dumps(header, separators=(",", ":")).encode()
    body = zstandard.ZstdCompressor(level=19).compress(b"".join(sections))
    content = MAGIC + struct.pack("<I", len(head)) + head + body
    return content + hashlib.sha256(content).digest()


def from_blob(blob: bytes, decoder: DecoderWeights, config: ImplicitMapConfig) -> NeuralMap:
    """The neural map in `blob`. Raises DataLoss for damage, DescriptorModelMismatch for another decoder."""
    content, digest = blob[:-32], blob[-32:]
    if not content.startswith(MAGIC) or hashlib.sha256(content).digest() != digest:
        raise DataLoss("the stored neural map is damaged")
    (size,) = struct.unpack_from("<I", content, len(MAGIC))
    start = len(MAGIC) + 4
    header = json.loads(content[start : start + size])
    if header["decoder"] != decoder.digest:
        raise DescriptorModelMismatch("the neural map was fitted with another decoder")
    body = zstandard.ZstdDecompressor().decompress(content[start + size :], max_output_size=64 * _MAX_POINTS)
    return _parse(header, body, decoder, config)


def _parse(header: dict[str, object], body: bytes, decoder: DecoderWeights, config: ImplicitMapConfig) -> NeuralMap:
    count, width, resolution = int(header["count"]), int(header["features"]), float(header["resolution"])  # type: ignore[call-overload, arg-type]
    bounds = np.cumsum([0, *header["sections"]])  # type: ignore[misc]
    parts = [body[a:b] for a, b in zip(bounds[:-1], bounds[1:], strict=True)]
    voxels = np.stack([np.cumsum(_from_varint(parts[axis], count)) for axis in range(3)], axis=1).astype(np.int32)
    octahedral = np.frombuffer(parts[3], np.uint8).reshape(2, count).T
    positions, normals = _geometry((voxels, octahedral, np.frombuffer(parts[4], np.uint8)), resolution)
    hits = np.frombuffer(parts[5], np.uint8).astype(np.int16)
    features = np.frombuffer(parts[6], np.int8).reshape(width, count).T.astype(np.float32) * np.float32(FEATURE_STEP)
    stamps = np.asarray(header["stamps_ns"], dtype=np.int64)
    created, updated = np.zeros(count, np.int16), np.full(count, len(stamps) - 1, np.int16)
    points = NeuralPoints(positions, normals, created, updated, hits, hits.astype(np.float32))
    return NeuralMap(points, np.ascontiguousarray(features), stamps, decoder, config)


def _geometry_codes(points: NeuralPoints, resolution: float) -> Codes:
    """Voxels (n, 3) int32, octahedral normals (n, 2) uint8 and plane offsets (n,) uint8."""
    voxels = np.floor(points.positions / resolution).astype(np.int32)
    octahedral = _to_octahedral(points.normals)
    normals = _from_octahedral(octahedral)
    centres = (voxels + 0.5) * resolution
    reach = resolution * np.sqrt(3.0) / 2
    offset = np.einsum("ij,ij->i", points.positions - centres, normals) / reach
    codes = np.clip(np.rint((offset + 1) * 0.5 * _OFFSET_LEVELS), 0, _OFFSET_LEVELS).astype(np.uint8)
    return voxels, octahedral, codes


def _geometry(codes: Codes, resolution: float) -> tuple[Array, Array]:
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


def _varint(values: NDArray[np.integer]) -> bytes:
    """Small signed numbers as bytes: zigzag, one byte below 255, else 255 and four more."""
    zigzag = ((values.astype(np.int64) << 1) ^ (values.astype(np.int64) >> 63)).astype(np.uint32)
    small = np.minimum(zigzag, 255).astype(np.uint8)
    large = zigzag[zigzag >= 255].astype("<u4")
    return small.tobytes() + large.tobytes()


def _from_varint(data: bytes, count: int) -> NDArray[np.int64]:
    """The inverse of `_varint` for `count` numbers."""
    values = np.frombuffer(data, np.uint8, count).astype(np.int64)
    values[values == 255] = np.frombuffer(data, "<u4", offset=count)
    return np.asarray((values >> 1) ^ -(values & 1))
