"""Occupied voxels as a stream of bits: an octree whose branches are guessed from what is known around them."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import loop
from revisit.core.kernels.range_coder import Coder, Models, code_bit
from revisit.core.kernels.voxel_table import VoxelTable, add, find

Voxels = NDArray[np.int32]

OCTREE_MODELS = 3 * 8 * 64 * 8
THINNED_MODELS = 4 * 8 * 64 * 8
"""Models of an octree of which a `Thinning` leaves voxels out."""
RANKS = 1 << 16
_STEPS = (53685, 43977, 36025)  # of RANKS: powers of 1 / g, g^4 = g + 1, so that ranks are spread evenly


class Thinning(NamedTuple):
    """Which voxels are kept of a surface: those of a rank below `below`, seldom others; `low` is their lowest voxel.

    Ranks are spread evenly over space, whatever part of them is kept.
    """

    low: tuple[int, int, int]
    below: int


_WHOLE = Thinning((0, 0, 0), RANKS)


def ranks_of(voxels: NDArray[np.integer]) -> NDArray[np.int64]:
    """The rank (n,) of each voxel (n, 3), 0 to RANKS - 1."""
    return np.asarray(voxels.astype(np.int64) @ np.array(_STEPS) & (RANKS - 1))


def code_octree(
    coder: Coder, data: NDArray[np.uint8], models: Models, voxels: Voxels, depth: int, count: int,
    thinning: Thinning = _WHOLE,
) -> Voxels:  # fmt: skip
    """Write `voxels` (count, 3), distinct and in 0..2^depth-1, or read `count` where none are given.

    Returns them in the order of the tree. With a `thinning` there are THINNED_MODELS models, else OCTREE_MODELS.

    A damaged stream gives fewer or other voxels, never more than `count`.
    """
    corner = int(ranks_of(np.array([thinning.low]))[0])
    nodes = np.zeros((1, 3), dtype=np.int32)
    for level in range(depth):
        shift = depth - 1 - level
        parents, children = _table(len(nodes)), _table(min(8 * len(nodes), count))
        wanted = np.zeros(len(nodes), dtype=np.int64)
        _enter(parents, nodes)
        _mark_children(parents, voxels, shift, wanted)
        size = _code_level(coder, data, models, nodes, parents, wanted, children, min(shift, 2), corner, thinning.below)
        nodes = children.voxels[:size].copy()
    return nodes


def _table(rows: int) -> VoxelTable:
    """An empty table with room for so many rows."""
    slots = 64
    while slots < 2 * rows:
        slots *= 2
    return VoxelTable(np.full(slots, -1, np.int32), np.full(rows, -1, np.int32), np.zeros((rows, 3), np.int32))


@loop
def _enter(table: VoxelTable, nodes: Voxels) -> None:
    """Enter the distinct `nodes` (n, 3), each as its row."""
    for row in range(len(nodes)):
        add(table, row, nodes[row, 0], nodes[row, 1], nodes[row, 2])


@loop
def _mark_children(parents: VoxelTable, voxels: Voxels, shift: int, wanted: NDArray[np.int64]) -> None:
    """Set a bit in `wanted` (n,) for each child of the n `parents` that any of `voxels` lies in.

    The edge of a child is 2^shift voxels.
    """
    for row in range(len(voxels)):
        x, y, z = voxels[row, 0] >> shift, voxels[row, 1] >> shift, voxels[row, 2] >> shift
        node = find(parents, x >> 1, y >> 1, z >> 1)
        wanted[node] |= 1 << (4 * (x & 1) + 2 * (y & 1) + (z & 1))


@loop
def _code_level(
    coder: Coder, data: NDArray[np.uint8], models: Models, nodes: Voxels, parents: VoxelTable,
    wanted: NDArray[np.int64], children: VoxelTable, detail: int, corner: int, below: int,
) -> int:  # fmt: skip
    """The occupied children of `nodes` (n, 3), which are `wanted` (n,) where the coder writes, a bit each.

    `detail` is 0 for the finest level, 1 for the one above, else 2. Voxels of the finest level with a rank of `below`
    or more are seldom there; `corner` is the rank of voxel 0.
    """
    size = 0
    for row in range(len(nodes)):
        px, py, pz = nodes[row, 0], nodes[row, 1], nodes[row, 2]
        beside, before, coded = _beside(parents, px, py, pz), size, 0
        # below, above, and at the two sides already passed, how many are occupied
        passed = (beside >> 2 & 1) + (beside >> 5 & 1) + (1 if beside & 3 else 0)
        for child in range(8):
            if size == len(children.voxels):
                return size
            x, y, z = 2 * px + (child >> 2), 2 * py + (child >> 1 & 1), 2 * pz + (child & 1)
            bit = 1
            if child < 7 or size > before:  # the last child of an otherwise empty node is certain
                known = 4 * min(size - before, 1) + passed
                around = _around(children, beside, coded, child, x, y, z)
                part = 3 if detail == 0 and _rank(corner, x, y, z) >= below else detail
                model = ((part * 8 + child) * 64 + around) * 8 + known
                bit = code_bit(coder, data, models, model, wanted[row] >> child & 1)
            if bit:
                add(children, size, x, y, z)
                size += 1
                coded |= 1 << child
    return size


@numba.njit(inline="always")
def _rank(corner: int, x: int, y: int, z: int) -> int:
    """As `ranks_of`, of a voxel `corner` away."""
    return (corner + x * _STEPS[0] + y * _STEPS[1] + z * _STEPS[2]) & (RANKS - 1)


@numba.njit(inline="always")
def _beside(parents: VoxelTable, x: int, y: int, z: int) -> int:
    """Which of the six neighbours of a node are occupied, one bit each: below along x, y, z, then above."""
    beside = 1 if find(parents, x - 1, y, z) >= 0 else 0
    beside |= 2 if find(parents, x, y - 1, z) >= 0 else 0
    beside |= 4 if find(parents, x, y, z - 1) >= 0 else 0
    beside |= 8 if find(parents, x + 1, y, z) >= 0 else 0
    beside |= 16 if find(parents, x, y + 1, z) >= 0 else 0
    beside |= 32 if find(parents, x, y, z + 1) >= 0 else 0
    return beside


@numba.njit(inline="always")
def _around(children: VoxelTable, beside: int, coded: int, child: int, x: int, y: int, z: int) -> int:
    """What is known of the six neighbours of a child, one bit each: itself where it is coded, else its parent.

    A neighbour within the node is one of the `coded` children or has the node itself as its parent. One in a node
    `beside` that is empty is empty too, so that it is not sought.
    """
    known = 0
    if child & 4:
        known |= coded >> (child - 4) & 1
        known |= beside & 8
    else:
        known |= 8 if beside & 1 == 0 or find(children, x - 1, y, z) < 0 else 9
    if child & 2:
        known |= (coded >> (child - 2) & 1) << 1
        known |= beside & 16
    else:
        known |= 16 if beside & 2 == 0 or find(children, x, y - 1, z) < 0 else 18
    if child & 1:
        known |= (coded >> (child - 1) & 1) << 2
        known |= beside & 32
    else:
        known |= 32 if beside & 4 == 0 or find(children, x, y, z - 1) < 0 else 36
    return known
