"""Occupied voxels as a stream of bits: an octree whose branches are guessed from coded neighbours."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, loop
from revisit.core.kernels.range_coder import Coder, Models, code_bit
from revisit.core.kernels.voxel_table import VoxelTable, add, find

Voxels = NDArray[np.int32]

THINNED_MODELS = 4 * 8 * 64 * 8
"""Models of an octree of which a `Thinning` leaves voxels out."""
RANKS = 1 << 16
_STEPS = (53685, 43977, 36025)  # of RANKS: powers of 1 / g, g^4 = g + 1, so that ranks are spread evenly


class Thinning(NamedTuple):
    """Which voxels are kept of a surface: those of a rank below `below`, seldom others; `low` is their lowest voxel.

    Any part of the ranks is spread evenly over space.
    """

    low: tuple[int, int, int]
    below: int


def ranks_of(voxels: NDArray[np.integer]) -> NDArray[np.int64]:
    """The rank (n,) of each voxel (n, 3), 0 to RANKS - 1."""
    return np.asarray(voxels.astype(np.int64) @ np.array(_STEPS) & (RANKS - 1))


def code_octree(
    coder: Coder, data: NDArray[np.uint8], models: Models, voxels: Voxels, depth: int, count: int,
    thinning: Thinning,
) -> Voxels:  # fmt: skip
    """Write `voxels` (count, 3), distinct and in 0..2^depth-1, or read `count` where none are given.

    Returns them in the order of the tree; there are THINNED_MODELS models. A damaged stream gives fewer or other
    voxels, never more than `count`.
    """
    corner = int(ranks_of(np.array([thinning.low]))[0])
    parents, size = _table(1), 1
    _enter_root(parents)
    for level in range(depth):
        shift = depth - 1 - level
        children, masks = _table(min(8 * size, count)), np.zeros(size, dtype=np.int64)
        mark_children(parents, voxels, shift, masks)
        size = _code_level(coder, data, models, parents, masks, children, min(shift, 2), corner, thinning.below)
        parents = VoxelTable(children.slots, children.following, children.voxels[:size])
    return parents.voxels.copy()


def _table(rows: int) -> VoxelTable:
    """An empty table with room for so many rows."""
    slots = 64
    while slots < 2 * rows:
        slots *= 2
    return VoxelTable(np.full(slots, -1, np.int32), np.full(rows, -1, np.int32), np.zeros((rows, 3), np.int32))


@loop
def _enter_root(table: VoxelTable) -> None:
    """Enter voxel (0, 0, 0) as row 0."""
    add(table, 0, 0, 0, 0)


@loop
def mark_children(parents: VoxelTable, voxels: Voxels, shift: int, masks: NDArray[np.integer]) -> None:
    """Set a bit in `masks` (n,) for each child of the n `parents` that any of `voxels` lies in.

    The edge of a child is 2^shift voxels.
    """
    for row in range(len(voxels)):
        x, y, z = voxels[row, 0] >> shift, voxels[row, 1] >> shift, voxels[row, 2] >> shift
        node = find(parents, x >> 1, y >> 1, z >> 1)
        masks[node] |= 1 << (4 * (x & 1) + 2 * (y & 1) + (z & 1))


@loop
def _code_level(
    coder: Coder, data: NDArray[np.uint8], models: Models, parents: VoxelTable, masks: NDArray[np.int64],
    children: VoxelTable, detail: int, corner: int, below: int,
) -> int:  # fmt: skip
    """Enter the occupied children of the n `parents`; how many. `masks` (n,) say which these are, a bit each, or are 0
    and become that where the coder reads.

    `detail` is 0 for the finest level, 1 for the one above, else 2. Voxels of the finest level with a rank of `below`
    or more are seldom there; `corner` is the rank of voxel 0.
    """
    size, nodes = 0, parents.voxels
    for row in range(len(nodes)):
        px, py, pz = nodes[row, 0], nodes[row, 1], nodes[row, 2]
        left = find(parents, px - 1, py, pz)
        front = find(parents, px, py - 1, pz)
        under = find(parents, px, py, pz - 1)
        right = 8 if find(parents, px + 1, py, pz) >= 0 else 0
        behind = 8 if find(parents, px, py + 1, pz) >= 0 else 0
        above = 8 if find(parents, px, py, pz + 1) >= 0 else 0
        # below, above, and at the two sides already passed, how many are occupied
        passed = (1 if under >= 0 else 0) + above // 8 + (1 if left >= 0 or front >= 0 else 0)
        before, wanted, coded = size, masks[row], 0
        for child in range(8):
            if size == len(children.voxels):
                return size
            x, y, z = 2 * px + (child >> 2), 2 * py + (child >> 1 & 1), 2 * pz + (child & 1)
            bit = 1
            if child < 7 or size > before:  # the last child of an otherwise empty node is certain
                around = _known(masks, left, row, coded, child, 4, right)
                around |= _known(masks, front, row, coded, child, 2, behind) << 1
                around |= _known(masks, under, row, coded, child, 1, above) << 2
                part = 3 if detail == 0 and _rank(corner, x, y, z) >= below else detail
                model = ((part * 8 + child) * 64 + around) * 8 + 4 * min(size - before, 1) + passed
                bit = code_bit(coder, data, models, model, wanted >> child & 1)
            if bit:
                add(children, size, x, y, z)
                size += 1
                coded |= 1 << child
        masks[row] = coded
    return size


@inlined
def _rank(corner: int, x: int, y: int, z: int) -> int:
    """As `ranks_of`, of a voxel `corner` away."""
    return (corner + x * _STEPS[0] + y * _STEPS[1] + z * _STEPS[2]) & (RANKS - 1)


@inlined
def _known(masks: NDArray[np.int64], node: int, row: int, coded: int, child: int, side: int, beyond: int) -> int:
    """Along one axis: 1 where the child before is occupied, and 8 where there may be one behind.

    `side` is the bit of `child` that tells the two of a node apart. Before the second lies the first, which is one of
    the `coded` or not, and there may be one behind where `beyond` is 8. Before the first lies a child of `node`, if
    there is one and it comes before `row`; behind it its own node goes on.
    """
    if child & side:
        return (coded >> (child - side) & 1) | beyond
    return 8 | (masks[node] >> (child + side) & 1 if 0 <= node < row else 0)
