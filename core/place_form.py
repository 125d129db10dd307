"""The stored form of a place (docs/decisions/0155): keypoints in small whole numbers, the surface coded by context."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.container import Container
from revisit.core.errors import DataLoss

Array = NDArray[np.float32]

CONTAINER = Container(b"RVPS\x02", "stored place", level=9, max_body_bytes=4_000_000, digest_bytes=16, body_length=True)
DIMENSIONS = 32
"""Numbers of a keypoint's descriptor that are kept, those of most variance first."""
MAX_ROWS = 100_000

_KEYPOINT_UNIT_M = np.float32(0.1)
_ANGLES = 256
_INNER = 1.02  # of the root mean square of a descriptor: below it a number counts a third of one above
_STEPS = 32  # along an edge of a voxel, across a surface
_GROUND = 2  # voxels of the ground have edges so many times as long


@dataclass(frozen=True)
class PlaceContents:
    """What a blob holds: the arrays of `core.place.Place`, and how many of the points stand off the ground."""

    keypoints: Array
    orientations: Array
    descriptors: Array
    parity: Array
    points: Array
    normals: Array
    standing_count: int


def write_form(contents: PlaceContents, spacing: float) -> tuple[dict[str, Any], bytes]:
    """Header and body; `spacing` is the edge of the cubes of which the surface keeps a standing point each."""
    from revisit.core.place_surface import write_surface  # the gateway reads keypoints without compiled code

    standing = contents.standing_count
    streams = (
        write_surface(contents.points[:standing], contents.normals[:standing], spacing, _STEPS),
        write_surface(contents.points[standing:], contents.normals[standing:], _GROUND * spacing, _GROUND * _STEPS),
    )
    parity = contents.parity[:DIMENSIONS]
    header = {
        "keypoints": len(contents.keypoints), "size": len(parity), "spacing": float(spacing),
        "standing": len(streams[0]), "ground": len(streams[1]),
    }  # fmt: skip
    sections = (_keypoints_written(contents), np.packbits(parity > 0).tobytes(), _levels_written(contents.descriptors))
    return header, b"".join([*sections, *streams])


def read_form(header: dict[str, Any], body: bytes, *, surface: bool) -> PlaceContents:
    """The inverse of `write_form`; without `surface` its points are left out. Raises DataLoss for anything else."""
    count, size = bounded(header, "keypoints", MAX_ROWS), bounded(header, "size", DIMENSIONS)
    standing, ground = (bounded(header, name, len(body)) for name in ("standing", "ground"))
    ends = np.cumsum([5 * count, (size + 7) // 8, (2 * count * size + 7) // 8, standing, ground])
    if len(body) != ends[-1]:
        raise DataLoss("the place's sections do not have the announced sizes")
    keypoints, orientations = _keypoints_read(body[: ends[0]], count)
    signs = np.unpackbits(np.frombuffer(body[ends[0] : ends[1]], np.uint8), count=size)
    levels = _levels_read(body[ends[1] : ends[2]], count, size)
    streams = (body[ends[2] : ends[3]], body[ends[3] :]) if surface else (b"", b"")
    points, normals, standing_count = _surface_read(streams, _spacing(header))
    parity = 2.0 * signs.astype(np.float32) - 1.0
    return PlaceContents(keypoints, orientations, directions(levels), parity, points, normals, standing_count)


def bounded(header: dict[str, Any], name: str, most: int) -> int:
    """A whole number of a header from 0 to `most`. Raises DataLoss for anything else."""
    value = header.get(name)
    if type(value) is not int or not 0 <= value <= most:
        raise DataLoss(f"the place's {name} is unusable")
    return value


def directions(rows: Array) -> Array:
    """The rows (n, l) as unit vectors; zero rows stay."""
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12), dtype=np.float32)


def _spacing(header: dict[str, Any]) -> float:
    spacing = header.get("spacing")
    if type(spacing) is not float or not 1e-3 <= spacing <= 1e3:
        raise DataLoss("the place's spacing is unusable")
    return spacing


def _keypoints_written(contents: PlaceContents) -> bytes:
    cells = np.clip(np.rint(contents.keypoints / _KEYPOINT_UNIT_M), -32767, 32767).astype("<i2")
    angles = np.rint(contents.orientations / np.pi * _ANGLES).astype(np.int64) % _ANGLES
    # all low bytes, then all high ones, of which few differ
    planes = np.ascontiguousarray(np.ascontiguousarray(cells.T).view(np.uint8).reshape(-1, 2).T)
    return bytes(planes.tobytes() + angles.astype(np.uint8).tobytes())


def _keypoints_read(data: bytes, count: int) -> tuple[Array, Array]:
    planes = np.frombuffer(data, np.uint8, 4 * count).reshape(2, -1)
    cells = np.ascontiguousarray(planes.T).view("<i2").reshape(2, count).T
    angles = np.frombuffer(data, np.uint8, count, 4 * count)
    return np.ascontiguousarray(cells * _KEYPOINT_UNIT_M), (angles * (np.pi / _ANGLES)).astype(np.float32)


def _levels_written(descriptors: Array) -> bytes:
    kept = directions(descriptors[:, :DIMENSIONS])
    large = np.abs(kept) > _INNER / np.sqrt(max(kept.shape[1], 1))
    return bytes(np.packbits(np.stack([kept >= 0.0, large], axis=-1)).tobytes())


def _levels_read(data: bytes, count: int, size: int) -> Array:
    bits = np.unpackbits(np.frombuffer(data, np.uint8), count=2 * count * size).reshape(count, size, 2)
    positive, large = bits[..., 0].astype(np.float32), bits[..., 1].astype(np.float32)
    return np.asarray((2.0 * positive - 1.0) * (1.0 + 2.0 * large), dtype=np.float32)


def _surface_read(streams: tuple[bytes, bytes], spacing: float) -> tuple[Array, Array, int]:
    if not any(streams):
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), 0
    from revisit.core.place_surface import read_surface

    standing, ground = (
        read_surface(stream, edges * spacing, edges * _STEPS, MAX_ROWS)
        for stream, edges in zip(streams, (1, _GROUND), strict=True)
    )
    points, normals = (np.concatenate(parts) for parts in zip(standing, ground, strict=True))
    return points, normals, len(standing[0])
