"""The surface of a place as stored: a point a voxel, coarse along its plane, fine across (docs/decisions/0155)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import zstandard
from numpy.typing import NDArray

from revisit.core.container import decompressed
from revisit.core.errors import DataLoss
from revisit.core.geometry import octahedral
from revisit.core.geometry.voxel_keys import first_rows, voxel_keys

Array = NDArray[np.float32]
Whole = NDArray[np.int64]

ACROSS = 4
"""Cells along an edge of a voxel, across the axis that a normal is nearest to."""
NORMAL_STEPS = 7
CORNER = 0.5 / ACROSS
"""By how much of an edge voxels begin before the origin.

The vertices of a surface lie on planes through the origin, two or four to a voxel: so they are in the middle of cells.
"""
MAX_DEPTH = 16

_FARTHEST_VOXEL = 1 << (MAX_DEPTH - 1)
_LEAST_COMPONENT = 0.3
_NORMAL_CODES = 2 * NORMAL_STEPS + 1
_HEAD = np.dtype("<i4")
_PARTS = 6  # numbers of the head: lowest voxel, depth, bytes of the tree and of the normals
_ZSTD_LEVEL = 19


def write_surface(points: Array, normals: Array, edge: float, steps: int) -> bytes:
    """Points (n, 3) and unit normals (n, 3) in voxels of `edge`, of each voxel the first; their order is not kept.

    Voxels as the masks of an octree from the root on, normals in a byte, places in their voxels bit by bit: one of
    `steps`, a power of two, along the axis that the normal is nearest to, one of ACROSS cells along either other. What
    is read again is written as the same bytes.
    """
    if not len(points):
        return b""
    voxels, places, codes = _rounded(points, normals, edge, steps)
    low = voxels.min(axis=0)
    depth = max(int((voxels - low).max()).bit_length(), 1)
    morton = _interleaved(voxels - low, depth)
    rows = np.argsort(morton)
    compress = zstandard.ZstdCompressor(level=_ZSTD_LEVEL, write_content_size=True).compress
    tree = compress(_masks(morton[rows], depth))
    facing = compress((codes[rows, 0] * _NORMAL_CODES + codes[rows, 1]).astype(np.uint8).tobytes())
    head = np.array([*low, depth, len(tree), len(facing)], dtype=_HEAD).tobytes()
    return head + tree + facing + _packed_places(places[rows], _along(codes[rows]), steps)


def read_surface(stream: bytes, edge: float, steps: int, limit: int) -> tuple[Array, Array]:
    """Points (n, 3) and normals (n, 3) of a stream. Raises DataLoss for what `write_surface` did not write."""
    if not stream:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
    start = _PARTS * _HEAD.itemsize
    if len(stream) < start:
        raise DataLoss("the surface of the place is cut short")
    *low, depth, tree, facing = (int(number) for number in np.frombuffer(stream, _HEAD, _PARTS))
    if not (1 <= depth <= MAX_DEPTH and min(tree, facing) >= 0 and max(map(abs, low)) <= _FARTHEST_VOXEL):
        raise DataLoss("the surface of the place is unusable")
    masks = decompressed(stream[start : start + tree], MAX_DEPTH * limit, "surface of the place")
    morton = _unmasked(np.frombuffer(masks, np.uint8), depth, limit)
    normals = decompressed(stream[start + tree : start + tree + facing], limit, "surface of the place")
    codes = np.stack(np.divmod(np.frombuffer(normals, np.uint8).astype(np.int64), _NORMAL_CODES), axis=1)
    packed = stream[start + tree + facing :]
    if len(codes) != len(morton) or codes.max() >= _NORMAL_CODES or len(packed) != _packed_size(len(morton), steps):
        raise DataLoss("the surface of the place does not hold what it says")
    within = _unpacked_places(packed, _along(codes), steps)
    positions = (_separated(morton, depth) + np.array(low) + within - CORNER) * edge
    return positions.astype(np.float32), octahedral.decode(codes, NORMAL_STEPS).astype(np.float32)


def _rounded(points: Array, normals: Array, edge: float, steps: int) -> tuple[Whole, Whole, Whole]:
    """Voxels (n, 3), places within them (n, 3) and codes of normals (n, 2): one point a voxel.

    A point moves within its plane to the middle of its cell, so that it stays on the surface, but never into the voxel
    of another point.
    """
    codes = octahedral.encode(normals, NORMAL_STEPS)
    # a normal straight down or on a fold has several codes: the one that is found again
    codes = octahedral.encode(octahedral.decode(codes, NORMAL_STEPS), NORMAL_STEPS)
    fine = _along(codes)
    exact, facing = points.astype(np.float64) / edge + CORNER, normals.astype(np.float64)
    exact = np.clip(exact, 1 - _FARTHEST_VOXEL // 2, _FARTHEST_VOXEL // 2 - 1)
    cells = np.floor(exact * ACROSS)
    aside = np.where(fine, 0.0, (cells + 0.5) / ACROSS - exact)
    slope = (facing * fine).sum(axis=1)
    slope = np.where(slope < 0.0, -1.0, 1.0) * np.maximum(np.abs(slope), _LEAST_COMPONENT)
    levels = np.floor((exact - fine * ((facing * aside).sum(axis=1) / slope)[:, None]) * steps)
    home = np.floor(exact)
    keys, count = voxel_keys(np.concatenate([home, np.where(fine, np.floor(levels / steps), home)])), len(home)
    taken = np.isin(keys[count:], keys[:count])  # by itself or another point
    levels = np.where(taken[:, None], np.clip(levels, steps * home, steps * home + steps - 1), levels)
    rows = np.sort(first_rows(np.where(taken, keys[:count], keys[count:])))
    voxels, places = np.divmod(np.where(fine, levels, cells)[rows], np.where(fine, steps, ACROSS)[rows])
    return voxels.astype(np.int64), places.astype(np.int64), codes[rows].astype(np.int64)


def _masks(morton: Whole, depth: int) -> bytes:
    """Which of the eight children of each node of the octree are there, level by level; `morton` (n,) ascends."""
    found = []
    for level in range(depth):
        children = morton >> (3 * (depth - 1 - level))
        children = children[np.diff(children, prepend=-1) != 0]
        first = np.flatnonzero(np.diff(children >> 3, prepend=-1))
        found.append(np.add.reduceat(1 << (children & 7), first).astype(np.uint8).tobytes())
    return b"".join(found)


def _unmasked(masks: NDArray[np.uint8], depth: int, limit: int) -> Whole:
    """The inverse of `_masks`. Raises DataLoss where there are too few or too many masks, or over `limit` voxels."""
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


def _interleaved(voxels: Whole, depth: int) -> Whole:
    """The bits of the coordinates (n, 3), from the highest on, by turns x, y, z."""
    found = np.zeros(len(voxels), dtype=np.int64)
    for bit in range(depth):
        for axis in range(3):
            found |= ((voxels[:, axis] >> bit) & 1) << (3 * bit + 2 - axis)
    return found


def _separated(morton: Whole, depth: int) -> Whole:
    """The inverse of `_interleaved`."""
    found = np.zeros((len(morton), 3), dtype=np.int64)
    for bit in range(depth):
        for axis in range(3):
            found[:, axis] |= ((morton >> (3 * bit + 2 - axis)) & 1) << bit
    return found


def _bits(steps: int) -> int:
    return steps.bit_length() - 1 + 4


def _packed_size(count: int, steps: int) -> int:
    return (_bits(steps) * count + 7) // 8


def _packed_places(places: Whole, fine: NDArray[np.bool_], steps: int) -> bytes:
    """The level along the steepest axis and the two cells in two bits each, bit by bit."""
    level, cells = places[fine], places[~fine].reshape(-1, 2)
    numbers = (level << 4) + (cells[:, 0] << 2) + cells[:, 1]
    return np.packbits((numbers[:, None] >> np.arange(_bits(steps))[::-1]) & 1).tobytes()


def _unpacked_places(packed: bytes, fine: NDArray[np.bool_], steps: int) -> NDArray[np.float64]:
    """Where in its voxel each point lies, (n, 3) in edges."""
    bits = np.unpackbits(np.frombuffer(packed, np.uint8), count=_bits(steps) * len(fine)).reshape(len(fine), -1)
    numbers = bits @ (1 << np.arange(_bits(steps))[::-1])
    within = np.empty((len(fine), 3))
    within[fine] = ((numbers >> 4) + 0.5) / steps
    within[~fine] = (np.stack([(numbers >> 2) & 3, numbers & 3], axis=1).ravel() + 0.5) / ACROSS
    return within


def _along(codes: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Which axis (n, 3) each normal is nearest to, one for each; of two alike the first."""
    return np.asarray(_steepest()[codes[:, 0], codes[:, 1]][:, None] == np.arange(3))


@lru_cache(maxsize=1)
def _steepest() -> NDArray[np.int64]:
    """The axis that the normal of each octahedral code is nearest to."""
    side = np.arange(_NORMAL_CODES)
    codes = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    parts = np.rint(np.abs(octahedral.decode(codes, NORMAL_STEPS)) * 1024)  # whole: alike on every machine
    return np.asarray(parts.argmax(axis=1).reshape(_NORMAL_CODES, _NORMAL_CODES))
