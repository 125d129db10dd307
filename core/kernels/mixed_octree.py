"""Occupied voxels as a stream of bits: an octree whose branches are each guessed by several models."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, loop
from revisit.core.kernels.mixed_coder import Mixture, mixed_bit
from revisit.core.kernels.octree_coder import mark_children
from revisit.core.kernels.octree_nodes import AROUND, PLACES, STEPS, OctreeLevel, neighbours_of_all, top_level
from revisit.core.kernels.range_coder import Coder
from revisit.core.kernels.voxel_table import table_of

Whole = NDArray[np.int32]

RANGES = 16
HEIGHTS = 32
_DETAILS = 3
_FACES = 3**6  # of each of six voxels: not there, there, not known yet
_COUNTS = 7 * 7 * 7
_LAYERS = 6 * 6 * 6
_FIRST = np.cumsum(
    [0, _DETAILS * 8 * _FACES * 2, 6 * HEIGHTS * RANGES * 2, _DETAILS * 64 * 256, _DETAILS * _COUNTS * RANGES,
     _DETAILS * _LAYERS * 4]
)  # fmt: skip
OCTREE_MODELS = int(_FIRST[-1])
OCTREE_SETS = _DETAILS * 5 * 4
_FACE, _EDGE, _UNDER, _LEVEL, _OVER, _ALL = range(0, 48, 8)


def _counted() -> NDArray[np.int64]:
    """For each byte of a mask of 26 voxels and its value: how many of them share a face, how many an edge with the one
    between, how many are below, level with it and above, and how many there are, eight bits each.
    """
    far, up = np.abs(STEPS).sum(axis=1), STEPS[:, 2]
    kinds = np.stack([far == 1, far == 2, up == -1, up == 0, up == 1, far > 0], axis=1).astype(np.int64)
    each = np.zeros(32, np.int64)
    each[: len(STEPS)] = kinds @ (1 << np.array([_FACE, _EDGE, _UNDER, _LEVEL, _OVER, _ALL], dtype=np.int64))
    return (np.arange(256)[:, None] >> np.arange(8) & 1) @ each.reshape(4, 8, 1)


_COUNTED = _counted().reshape(4, 256)
_TERNARY = (np.arange(64)[:, None] >> np.arange(6) & 1) @ 3 ** np.arange(6)
_FARTHEST = 1 << 12
_RANGE = np.minimum(np.floor(2 * np.log2(np.arange(_FARTHEST) / 4 + 1)), RANGES - 1).astype(np.int64)
"""The class of a distance whose square is so many times 64 voxels."""


def code_mixed_octree(
    coder: Coder,
    data: NDArray[np.uint8],
    mixture: Mixture,
    voxels: Whole,
    low: NDArray[np.int64],
    depth: int,
    count: int,
) -> OctreeLevel:
    """Write `voxels` (count, 3), distinct and in 0..2^depth-1, or read `count` where none are given.

    Returns them in the order of the tree. `low` (3,) is the voxel 0 of them as seen from the middle of the map: how far
    one is from there, and how high, says how likely it is.

    A damaged stream gives fewer or other voxels, never more than `count`.
    """
    level = top_level()
    for above in range(depth):
        shift = depth - 1 - above
        nodes, around = level.voxels, neighbours_of_all(level)
        masks, first = np.zeros(len(nodes), np.int32), np.zeros(len(nodes), np.int32)
        if len(voxels):
            mark_children(table_of(nodes), voxels, shift, masks)
        room = min(8 * len(nodes), count)
        level = OctreeLevel(np.zeros((room, 3), np.int32), np.zeros(room, np.int32), around, first, masks)
        size = _code_level(coder, data, mixture, nodes, level, low, shift)
        level = level._replace(voxels=level.voxels[:size], own=level.own[:size])
    return level


@loop
def _code_level(
    coder: Coder, data: NDArray[np.uint8], mixture: Mixture, nodes: Whole, level: OctreeLevel, low: NDArray[np.int64],
    shift: int,
) -> int:  # fmt: skip
    """Enter the occupied children of the n `nodes` into `level`; how many. Its masks say which these are, or are 0 and
    become that where the coder reads. The edge of a child is 2^shift voxels.
    """
    size, masks, detail = 0, level.masks, min(shift, 2)
    for row in range(len(nodes)):
        wanted, coded, before = masks[row], 0, size
        level.first[row] = size
        px, py, pz = 2 * nodes[row, 0], 2 * nodes[row, 1], 2 * nodes[row, 2]
        beside = 0
        for k in range(6):
            beside |= (1 if level.around[row, k] >= 0 else 0) << k
        far = range_class(((px + 1) << shift) + low[0], ((py + 1) << shift) + low[1], ((pz + 1) << shift) + low[2])
        for child in range(8):
            if size == len(level.voxels):
                masks[row] = coded
                return size
            bit = 1
            if child < 7 or size > before:  # the last child of an otherwise empty node is certain
                known, hidden = _look_around(level, row, child, coded)
                z = _height(pz + (child & 1), shift, low[2])
                some = min(size - before, 3)
                which = _ask(mixture.at, known, hidden, detail, child, coded, some, beside, far, min(shift, 5), z)
                bit = mixed_bit(coder, data, mixture, 0, which, wanted >> child & 1)
            if bit:
                level.voxels[size, 0] = px + (child >> 2)
                level.voxels[size, 1] = py + (child >> 1 & 1)
                level.voxels[size, 2] = pz + (child & 1)
                level.own[size] = row
                size += 1
                coded |= 1 << child
        masks[row] = coded
    return size


@inlined
def _look_around(level: OctreeLevel, row: int, child: int, coded: int) -> tuple[int, int]:
    """Which of the 26 voxels around a child of node `row` are known to be there, and of which nothing is known yet."""
    known = AROUND[child, 0, coded]
    hidden = AROUND[child, 0, 255 & -(2 << child)]
    for k in range(1, 8):
        node = level.around[row, PLACES[child, k]]
        if node > row:
            hidden |= AROUND[child, k, 255]
        elif node >= 0:
            known |= AROUND[child, k, level.masks[node]]
    return int(known), int(hidden)


@inlined
def _ask(
    at: NDArray[np.int64], known: int, hidden: int, detail: int, child: int, coded: int, some: int, beside: int,
    far: int, edge: int, height: int,
) -> int:  # fmt: skip
    """Say in `at` which models are asked; returns the set of weights."""
    count = _COUNTED[0, known & 255] + _COUNTED[1, known >> 8 & 255] + _COUNTED[2, known >> 16 & 255]
    count += _COUNTED[3, known >> 24]
    faces, open_faces = _TERNARY[known & 63] + 2 * _TERNARY[hidden & 63], _COUNTED[0, hidden & 63] >> _FACE & 255
    around = ((count >> _FACE & 255) * 7 + open_faces) * 7 + min(count >> _EDGE & 255, 6)
    layers = (min(count >> _UNDER & 255, 5) * 6 + min(count >> _LEVEL & 255, 5)) * 6 + min(count >> _OVER & 255, 5)
    at[0] = _FIRST[0] + ((detail * 8 + child) * _FACES + faces) * 2 + min(some, 1)
    at[1] = _FIRST[1] + ((edge * HEIGHTS + height) * RANGES + far) * 2 + min(some, 1)
    at[2] = _FIRST[2] + (detail * 64 + beside) * 256 + (1 << child) + coded
    at[3] = _FIRST[3] + (detail * _COUNTS + around) * RANGES + far
    at[4] = _FIRST[4] + (detail * _LAYERS + layers) * 4 + (child & 1) * 2 + min(some, 1)
    return int((detail * 5 + min(count >> _ALL & 255, 4)) * 4 + some)


@inlined
def range_class(x: int, y: int, z: int) -> int:
    """One of RANGES classes of how far a voxel is from the middle of the map."""
    x, y, z = min(abs(x), 1 << 12), min(abs(y), 1 << 12), min(abs(z), 1 << 12)
    return int(_RANGE[min((x * x + y * y + z * z) >> 6, _FARTHEST - 1)])


@inlined
def _height(z: int, shift: int, low: int) -> int:
    """One of HEIGHTS classes of how high the middle of a voxel is, in halves of its edge."""
    finer = max(shift - 1, 0)
    return int(
        min(max(((z << shift) + low + (1 << shift >> 1)) >> finer, -HEIGHTS // 2), HEIGHTS // 2 - 1) + HEIGHTS // 2
    )
