"""The stored form of a place (docs/decisions/0155, 0217): keypoints in small whole numbers, the surface by context."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.container import Container
from revisit.core.errors import DataLoss
from revisit.core.place_keypoints import ANGLE_BITS, in_stored_order, read_keypoints, write_keypoints

Array = NDArray[np.float32]

CONTAINER = Container(b"RVPS\x03", "stored place", level=9, max_body_bytes=4_000_000, digest_bytes=16, body_length=True)
DIMENSIONS = 32
"""Numbers of a keypoint's descriptor that are kept, those of most variance first."""
MAX_ROWS = 100_000
KEYPOINT_UNIT_M = np.float32(0.1)
ANGLES = 1 << ANGLE_BITS

_INNER = 1.02  # of the root mean square of a descriptor: below it a number counts a third of one above


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

    standing, points, normals = contents.standing_count, contents.points, contents.normals
    parity = contents.parity[:DIMENSIONS]
    sections = (
        np.packbits(parity > 0).tobytes(),
        write_keypoints(*_coded_keypoints(contents)),
        write_surface(points[:standing], normals[:standing], spacing, "standing"),
        write_surface(points[standing:], normals[standing:], spacing, "ground"),
    )
    header = {
        "keypoints": len(contents.keypoints), "size": len(parity), "spacing": float(spacing),
        "sections": [len(section) for section in sections],
    }  # fmt: skip
    return header, b"".join(sections)


def settled_form(contents: PlaceContents, spacing: float) -> PlaceContents:
    """What `read_form` reads of what `write_form` writes of `contents`, without writing it."""
    from revisit.core.place_surface import settled_surface

    standing, points, normals = contents.standing_count, contents.points, contents.normals
    standing_points, standing_normals = settled_surface(points[:standing], normals[:standing], spacing, "standing")
    ground_points, ground_normals = settled_surface(points[standing:], normals[standing:], spacing, "ground")
    cells, angles, bits = _coded_keypoints(contents)
    rows = in_stored_order(cells)
    parity = np.where(contents.parity[:DIMENSIONS] > 0, np.float32(1.0), np.float32(-1.0))
    return PlaceContents(
        *_keypoints_of(cells[rows], angles[rows], bits[rows]), parity,
        np.concatenate([standing_points, ground_points]), np.concatenate([standing_normals, ground_normals]),
        len(standing_points),
    )  # fmt: skip


def read_form(header: dict[str, Any], body: bytes, *, surface: bool) -> PlaceContents:
    """The inverse of `write_form`; without `surface` its points are left out. Raises DataLoss for anything else."""
    count, size = bounded(header, "keypoints", MAX_ROWS), bounded(header, "size", DIMENSIONS)
    parity, keypoints, standing, ground = _sections(header, body)
    if len(parity) != (size + 7) // 8:
        raise DataLoss("the place's sections do not have the announced sizes")
    signs = np.unpackbits(np.frombuffer(parity, np.uint8), count=size)
    cells, angles, bits = read_keypoints(keypoints, count, 2 * size)
    points, normals, standing_count = _surface_read((standing, ground) if surface else (b"", b""), spacing_of(header))
    signed = 2.0 * signs.astype(np.float32) - 1.0
    return PlaceContents(*_keypoints_of(cells, angles, bits), signed, points, normals, standing_count)


def _sections(header: dict[str, Any], body: bytes) -> list[bytes]:
    """The four parts of the body."""
    sizes = header.get("sections")
    if not isinstance(sizes, list) or len(sizes) != 4 or not all(type(n) is int and 0 <= n <= len(body) for n in sizes):
        raise DataLoss("the place's sections are unusable")
    ends = np.cumsum(sizes)
    if len(body) != ends[-1]:
        raise DataLoss("the place's sections do not have the announced sizes")
    return [body[end - size : end] for end, size in zip(ends, sizes, strict=True)]


def bounded(header: dict[str, Any], name: str, most: int) -> int:
    """A whole number of a header from 0 to `most`. Raises DataLoss for anything else."""
    value = header.get(name)
    if type(value) is not int or not 0 <= value <= most:
        raise DataLoss(f"the place's {name} is unusable")
    return value


def directions(rows: Array) -> Array:
    """The rows (n, l) as unit vectors; zero rows stay."""
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12), dtype=np.float32)


def spacing_of(header: dict[str, Any]) -> float:
    """The edge of the cubes of which the surface keeps a standing point each. Raises DataLoss for no length."""
    spacing = header.get("spacing")
    if type(spacing) is not float or not 1e-3 <= spacing <= 1e3:
        raise DataLoss("the place's spacing is unusable")
    return spacing


def levels_of(bits: NDArray[np.bool_]) -> Array:
    """Descriptors (n, l), not normalised, of two bits a number (n, 2 * l): whether positive, and whether large."""
    pairs = bits.reshape(len(bits), bits.shape[1] // 2, 2).astype(np.float32)
    return np.asarray((2.0 * pairs[..., 0] - 1.0) * (1.0 + 2.0 * pairs[..., 1]), dtype=np.float32)


def _keypoints_of(
    cells: NDArray[np.int64], angles: NDArray[np.int64], bits: NDArray[np.bool_]
) -> tuple[Array, Array, Array]:
    """Keypoints (n, 2), orientations (n,) and descriptors (n, l) of what is coded."""
    turned = (angles * (np.pi / ANGLES)).astype(np.float32)
    return np.asarray(cells * KEYPOINT_UNIT_M, dtype=np.float32), turned, directions(levels_of(bits))


def _coded_keypoints(
    contents: PlaceContents,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Cells (n, 2), angles (n,) and bits of the descriptors (n, 2 l), as they are written."""
    cells = np.clip(np.rint(contents.keypoints / KEYPOINT_UNIT_M), -32767, 32767).astype(np.int64)
    angles = np.rint(contents.orientations / np.pi * ANGLES).astype(np.int64) % ANGLES
    kept = directions(contents.descriptors[:, :DIMENSIONS])
    large = np.abs(kept) > _INNER / np.sqrt(max(kept.shape[1], 1))
    bits = np.stack([kept >= 0.0, large], axis=-1).reshape(len(kept), -1)
    return cells, angles, bits


def _surface_read(streams: tuple[bytes, bytes], spacing: float) -> tuple[Array, Array, int]:
    if not any(streams):
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), 0
    from revisit.core.place_surface import read_surface

    standing = read_surface(streams[0], spacing, MAX_ROWS, "standing")
    ground = read_surface(streams[1], spacing, MAX_ROWS, "ground")
    points, normals = (np.concatenate(parts) for parts in zip(standing, ground, strict=True))
    return points, normals, len(standing[0])
