"""The second stored form of a place, which is still read."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.container import Container, decompressed
from revisit.core.errors import DataLoss
from revisit.core.geometry import octahedral
from revisit.core.place_form import (
    DIMENSIONS,
    KEYPOINT_UNIT_M,
    MAX_ROWS,
    PlaceContents,
    bounded,
    directions,
    levels_of,
    spacing_of,
)
from revisit.core.place_keypoints import ANGLES

Array = NDArray[np.float32]
Whole = NDArray[np.int64]

CONTAINER = Container(b"RVPS\x02", "stored place", level=9, max_body_bytes=4_000_000, digest_bytes=16, body_length=True)
_STEPS = 32
_GROUND = 2
_ACROSS = 4
_CORNER = 0.5 / _ACROSS
_NORMAL_STEPS = 7
_MAX_DEPTH = 16
_FARTHEST_VOXEL = 1 << (_MAX_DEPTH - 1)
_NORMAL_CODES = 2 * _NORMAL_STEPS + 1
_HEAD = np.dtype("<i4")
_PARTS = 6  # numbers of the head: lowest voxel, depth, bytes of the tree and of the normals


def read_second_form(header: dict[str, Any], body: bytes, *, surface: bool) -> PlaceContents:
    """The arrays of a blob of the second form; without `surface` its points are left out. Raises DataLoss."""
    count, size = bounded(header, "keypoints", MAX_ROWS), bounded(header, "size", DIMENSIONS)
    standing, ground = (bounded(header, name, len(body)) for name in ("standing", "ground"))
    ends = np.cumsum([5 * count, (size + 7) // 8, (2 * count * size + 7) // 8, standing, ground])
    if len(body) != ends[-1]:
        raise DataLoss("the place's sections do not have the announced sizes")
    keypoints, orientations = _keypoints_read(body[: ends[0]], count)
    signs = np.unpackbits(np.frombuffer(body[ends[0] : ends[1]], np.uint8), count=size)
    levels = _levels_read(body[ends[1] : ends[2]], count, size)
    streams = (body[ends[2] : ends[3]], body[ends[3] :]) if surface else (b"", b"")
    points, normals, standing_count = _surface_read(streams, spacing_of(header))
    parity = 2.0 * signs.astype(np.float32) - 1.0
    return PlaceContents(keypoints, orientations, directions(levels), parity, points, normals, standing_count)


def _keypoints_read(data: bytes, count: int) -> tuple[Array, Array]:
    planes = np.frombuffer(data, np.uint8, 4 * count).reshape(2, -1)
    cells = np.ascontiguousarray(planes.T).view("<i2").reshape(2, count).T
    angles = np.frombuffer(data, np.uint8, count, 4 * count)
    return np.ascontiguousarray(cells * KEYPOINT_UNIT_M), (angles * (np.pi / ANGLES)).astype(np.float32)


def _levels_read(data: bytes, count: int, size: int) -> Array:
    return levels_of(np.unpackbits(np.frombuffer(data, np.uint8), count=2 * count * size).reshape(count, 2 * size) > 0)


def _surface_read(streams: tuple[bytes, bytes], spacing: float) -> tuple[Array, Array, int]:
    if not any(streams):
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), 0
    standing, ground = (
        _read_surface(stream, edges * spacing, edges * _STEPS, MAX_ROWS)
        for stream, edges in zip(streams, (1, _GROUND), strict=True)
    )
    points, normals = (np.concatenate(parts) for parts in zip(standing, ground, strict=True))
    return points, normals, len(standing[0])


def _read_surface(stream: bytes, edge: float, steps: int, limit: int) -> tuple[Array, Array]:
    """Points (n, 3) and normals (n, 3) of a stream. Raises DataLoss for anything else."""
    if not stream:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
    start = _PARTS * _HEAD.itemsize
    if len(stream) < start:
        raise DataLoss("the surface of the place is cut short")
    *low, depth, tree, facing = (int(number) for number in np.frombuffer(stream, _HEAD, _PARTS))
    if not (1 <= depth <= _MAX_DEPTH and min(tree, facing) >= 0 and max(map(abs, low)) <= _FARTHEST_VOXEL):
        raise DataLoss("the surface of the place is unusable")
    masks = decompressed(stream[start : start + tree], _MAX_DEPTH * limit, "surface of the place")
    morton = _unmasked(np.frombuffer(masks, np.uint8), depth, limit)
    normals = decompressed(stream[start + tree : start + tree + facing], limit, "surface of the place")
    codes = np.stack(np.divmod(np.frombuffer(normals, np.uint8).astype(np.int64), _NORMAL_CODES), axis=1)
    packed = stream[start + tree + facing :]
    if len(codes) != len(morton) or codes.max() >= _NORMAL_CODES or len(packed) != _packed_size(len(morton), steps):
        raise DataLoss("the surface of the place does not hold what it says")
    within = _unpacked_places(packed, _along(codes), steps)
    positions = (_separated(morton, depth) + np.array(low) + within - _CORNER) * edge
    return positions.astype(np.float32), octahedral.decode(codes, _NORMAL_STEPS).astype(np.float32)


def _unmasked(masks: NDArray[np.uint8], depth: int, limit: int) -> Whole:
    """The voxels, interleaved, of masks level by level: which children each node of the octree has.

    Raises DataLoss where there are too few or too many masks, or over `limit` voxels.
    """
    nodes, at = np.zeros(1, dtype=np.int64), 0
    for _ in range(depth):
        here = masks[at : at + len(nodes)]
        if len(here) != len(nodes) or len(nodes) > limit:
            raise DataLoss("the octree of the place does not fit")
        rows, children = np.nonzero(np.unpackbits(here, bitorder="little").reshape(-1, 8))
        nodes, at = (nodes[rows] << 3) + children, at + len(here)
    if at != len(masks) or not 0 < len(nodes) <= limit:
        raise DataLoss("the octree of the place does not fit")
    return nodes


def _separated(morton: Whole, depth: int) -> Whole:
    """Coordinates (n, 3) of numbers whose bits are theirs, from the highest on, by turns x, y, z."""
    found = np.zeros((len(morton), 3), dtype=np.int64)
    for bit in range(depth):
        for axis in range(3):
            found[:, axis] |= ((morton >> (3 * bit + 2 - axis)) & 1) << bit
    return found


def _bits(steps: int) -> int:
    return steps.bit_length() - 1 + 4


def _packed_size(count: int, steps: int) -> int:
    return (_bits(steps) * count + 7) // 8


def _unpacked_places(packed: bytes, fine: NDArray[np.bool_], steps: int) -> NDArray[np.float64]:
    """Where in its voxel each point lies, (n, 3) in edges."""
    bits = np.unpackbits(np.frombuffer(packed, np.uint8), count=_bits(steps) * len(fine)).reshape(len(fine), -1)
    numbers = bits @ (1 << np.arange(_bits(steps))[::-1])
    within = np.empty((len(fine), 3))
    within[fine] = ((numbers >> 4) + 0.5) / steps
    within[~fine] = (np.stack([(numbers >> 2) & 3, numbers & 3], axis=1).ravel() + 0.5) / _ACROSS
    return within


def _along(codes: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Which axis (n, 3) each normal is nearest to, one for each."""
    return np.asarray(octahedral.steepest_axes(_NORMAL_STEPS)[codes[:, 0], codes[:, 1]][:, None] == np.arange(3))
