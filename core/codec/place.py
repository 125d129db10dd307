"""The stored form of a place (docs/decisions/0287): small whole numbers, each coded by what is near."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.container import refuse_former
from revisit.core.codec.place_head import PlaceHead, pack_head, unpack_head
from revisit.core.codec.place_keypoints import ANGLES, Coded, in_stored_order, read_keypoints, write_keypoints
from revisit.core.errors import DataLoss
from revisit.core.kernels.keypoint_models import MOST_NUMBERS

Array = NDArray[np.float32]

MAGIC = b"RVPS\x04"
FORMER_MAGICS = (b"RVPS\x01", b"RVPS\x02", b"RVPS\x03")
DIGEST_BYTES = 16
"""A blob ends with so much of the SHA-256 of all before."""
DIMENSIONS = MOST_NUMBERS
"""Numbers of a keypoint's descriptor that are kept, those of most variance first."""
MAX_ROWS = 100_000
KEYPOINT_UNIT_M = np.float32(0.1)

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


def write_form(contents: PlaceContents, head: PlaceHead) -> bytes:
    """The blob of a place; the sizes in `head` become those of `contents`."""
    from revisit.core.codec.place_surface import write_surface  # the gateway reads keypoints without compiled code

    standing, points, normals, spacing = contents.standing_count, contents.points, contents.normals, head.spacing
    parity, keypoints = contents.parity[:DIMENSIONS], write_keypoints(*_coded(contents))
    surface = write_surface(points[:standing], normals[:standing], spacing, "standing")
    ground = write_surface(points[standing:], normals[standing:], spacing, "ground")
    sized = replace(
        head, keypoints=len(contents.keypoints), numbers=len(parity), keypoint_bytes=len(keypoints),
        standing_bytes=len(surface),
    )  # fmt: skip
    content = MAGIC + pack_head(sized) + np.packbits(parity > 0).tobytes() + keypoints + surface + ground
    return content + _digest(content)


def settled_form(contents: PlaceContents, spacing: float) -> PlaceContents:
    """What `read_form` reads of what `write_form` writes of `contents`, without writing it."""
    from revisit.core.codec.place_surface import settled_surface

    standing, points, normals = contents.standing_count, contents.points, contents.normals
    standing_points, standing_normals = settled_surface(points[:standing], normals[:standing], spacing, "standing")
    ground_points, ground_normals = settled_surface(points[standing:], normals[standing:], spacing, "ground")
    cells, angles, bits = _coded(contents)
    rows = in_stored_order(cells)
    parity = np.where(contents.parity[:DIMENSIONS] > 0, np.float32(1.0), np.float32(-1.0))
    return PlaceContents(
        *keypoints_of(cells[rows], angles[rows], bits[rows]), parity,
        np.concatenate([standing_points, ground_points]), np.concatenate([standing_normals, ground_normals]),
        len(standing_points),
    )  # fmt: skip


def read_form(blob: bytes, *, surface: bool) -> tuple[PlaceHead, PlaceContents]:
    """The inverse of `write_form`; without `surface` its points are left out, and no compiled code is needed. Raises
    FormerForm, DataLoss for anything else.
    """
    refuse_former(blob, FORMER_MAGICS, "stored place")
    content, digest = blob[:-DIGEST_BYTES], blob[-DIGEST_BYTES:]
    if not content.startswith(MAGIC):
        raise DataLoss("not a stored place of this version")
    if _digest(content) != digest:
        raise DataLoss("the checksum of the stored place does not fit")
    head, length = unpack_head(content[len(MAGIC) :])
    if head.keypoints > MAX_ROWS or head.numbers > DIMENSIONS:
        raise DataLoss("the place's keypoints are unusable")
    sizes = (head.numbers + 7) // 8, head.keypoint_bytes, head.standing_bytes
    starts = np.cumsum([len(MAGIC) + length, *sizes]).tolist()
    if len(content) < starts[-1]:
        raise DataLoss("the place's sections do not have the announced sizes")
    parity, keypoints, standing, ground = (content[a:b] for a, b in pairwise([*starts, len(content)]))
    signs = np.unpackbits(np.frombuffer(parity, np.uint8), count=head.numbers)
    coded = read_keypoints(keypoints, head.keypoints, head.numbers, compiled=surface)
    points, normals, standing_count = surface_read((standing, ground) if surface else (b"", b""), head.spacing)
    signed = 2.0 * signs.astype(np.float32) - 1.0
    return head, PlaceContents(*keypoints_of(*coded), signed, points, normals, standing_count)


def read_head(blob: bytes) -> PlaceHead:
    """What a place of `write_form` says of itself. Raises DataLoss for an unusable head; the rest is not looked at."""
    return unpack_head(blob[len(MAGIC) :])[0]


def directions(rows: Array) -> Array:
    """The rows (n, l) as unit vectors; zero rows stay."""
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12), dtype=np.float32)


def levels_of(bits: NDArray[np.bool_]) -> Array:
    """Descriptors (n, l), not normalised, of two bits a number (n, 2 * l): whether positive, and whether large."""
    pairs = bits.reshape(len(bits), bits.shape[1] // 2, 2).astype(np.float32)
    return np.asarray((2.0 * pairs[..., 0] - 1.0) * (1.0 + 2.0 * pairs[..., 1]), dtype=np.float32)


def keypoints_of(
    cells: NDArray[np.int64], angles: NDArray[np.int64], bits: NDArray[np.bool_]
) -> tuple[Array, Array, Array]:
    """Keypoints (n, 2), orientations (n,) and descriptors (n, l) of what is coded."""
    turned = (angles * (np.pi / ANGLES)).astype(np.float32)
    return np.asarray(cells * KEYPOINT_UNIT_M, dtype=np.float32), turned, directions(levels_of(bits))


def coded_form(keypoints: Array, orientations: Array, descriptors: Array) -> Coded:
    """Cells (n, 2), angles (n,) and bits of the descriptors (n, 2 l), as they are written."""
    cells = np.clip(np.rint(keypoints / KEYPOINT_UNIT_M), -32767, 32767).astype(np.int64)
    angles = np.rint(orientations / np.pi * ANGLES).astype(np.int64) % ANGLES
    kept = directions(descriptors[:, :DIMENSIONS])
    large = np.abs(kept) > _INNER / np.sqrt(max(kept.shape[1], 1))
    bits = np.stack([kept >= 0.0, large], axis=-1).reshape(len(kept), -1)
    return cells, angles, bits


def _coded(contents: PlaceContents) -> Coded:
    return coded_form(contents.keypoints, contents.orientations, contents.descriptors)


def surface_read(streams: tuple[bytes, bytes], spacing: float) -> tuple[Array, Array, int]:
    """Points (n, 3), normals (n, 3) and how many of them stand, of the streams of both kinds. Raises DataLoss."""
    if not any(streams):
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), 0
    from revisit.core.codec.place_surface import read_surface

    standing = read_surface(streams[0], spacing, MAX_ROWS, "standing")
    ground = read_surface(streams[1], spacing, MAX_ROWS, "ground")
    points, normals = (np.concatenate(parts) for parts in zip(standing, ground, strict=True))
    return points, normals, len(standing[0])


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).digest()[:DIGEST_BYTES]
