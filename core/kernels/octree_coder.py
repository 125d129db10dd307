"""Occupied voxels as a stream of bits: an octree whose branches are guessed from what is known around them."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.range_coder import Coder, Models, code_bit
from revisit.core.kernels.voxel_table import VoxelTable, add, find

Voxels = NDArray[np.int32]

OCTREE_MODELS = 3 * 8 * 64 * 8


@numba.njit(cache=True)
def code_octree(
    coder: Coder, data: NDArray[np.uint8], models: Models, voxels: Voxels, depth: int, count: int
) -> Voxels:
    """Write `voxels` (count, 3), distinct and in 0..2^depth-1, or read `count` where none are given.

    Returns them in the order of the tree.

    A damaged stream gives fewer or other voxels, never more than `count`.
    """
    nodes = np.zeros((1, 3), dtype=np.int32)
    for level in range(depth):
        shift = depth - 1 - level
        wanted = _table(len(voxels))
        if len(voxels):
            _enter(wanted, voxels, shift)
        children = _table(min(8 * len(nodes), count))
        size = _code_level(coder, data, models, nodes, wanted, children, min(shift, 2))
        nodes = children.voxels[:size].copy()
    return nodes


@numba.njit(cache=True)
def _table(rows: int) -> VoxelTable:
    """An empty table with room for so many rows."""
    slots = 64
    while slots < 2 * rows:
        slots *= 2
    return VoxelTable(np.full(slots, -1, np.int32), np.full(rows, -1, np.int32), np.zeros((rows, 3), np.int32))


@numba.njit(cache=True)
def _enter(table: VoxelTable, voxels: Voxels, shift: int) -> None:
    """Enter the nodes of the tree above `voxels` (n, 3), whose edge is 2^shift voxels."""
    size = 0
    for row in range(len(voxels)):
        x, y, z = voxels[row, 0] >> shift, voxels[row, 1] >> shift, voxels[row, 2] >> shift
        if find(table.slots, table.following, table.voxels, x, y, z) < 0:
            add(table.slots, table.following, table.voxels, size, x, y, z)
            size += 1


@numba.njit(cache=True)
def _code_level(
    coder: Coder, data: NDArray[np.uint8], models: Models, nodes: Voxels, wanted: VoxelTable, children: VoxelTable,
    detail: int,
) -> int:  # fmt: skip
    """The occupied children of `nodes` (n, 3); `detail` 0 for the finest level, 1 for the one above, else 2."""
    parents = _table(len(nodes))
    for row in range(len(nodes)):
        add(parents.slots, parents.following, parents.voxels, row, nodes[row, 0], nodes[row, 1], nodes[row, 2])
    size = 0
    for row in range(len(nodes)):
        before = size
        px, py, pz = nodes[row]
        for child in range(8):
            if size == len(children.voxels):
                return size
            x, y, z = 2 * px + (child >> 2), 2 * py + (child >> 1 & 1), 2 * pz + (child & 1)
            bit = 1
            if child < 7 or size > before:  # the last child of an otherwise empty node is certain
                known = 4 * min(size - before, 1) + _beside(parents, px, py, pz)
                model = ((detail * 8 + child) * 64 + _around(parents, children, x, y, z)) * 8 + known
                bit = code_bit(coder, data, models, model, _holds(wanted, x, y, z))
            if bit:
                add(children.slots, children.following, children.voxels, size, x, y, z)
                size += 1
    return size


@numba.njit(cache=True)
def _holds(table: VoxelTable, x: int, y: int, z: int) -> int:
    """1 where the table has voxel (x, y, z), else 0."""
    return 1 if find(table.slots, table.following, table.voxels, x, y, z) >= 0 else 0


@numba.njit(cache=True)
def _around(parents: VoxelTable, children: VoxelTable, x: int, y: int, z: int) -> int:
    """What is known of the six neighbours of a child, one bit each: itself where it is coded, else its parent."""
    coded = _holds(children, x - 1, y, z) | _holds(children, x, y - 1, z) << 1 | _holds(children, x, y, z - 1) << 2
    px, py, pz = x >> 1, y >> 1, z >> 1
    beside = _holds(parents, (x + 1) >> 1, py, pz) << 3 | _holds(parents, px, (y + 1) >> 1, pz) << 4
    return coded | beside | _holds(parents, px, py, (z + 1) >> 1) << 5


@numba.njit(cache=True)
def _beside(parents: VoxelTable, x: int, y: int, z: int) -> int:
    """Of a parent's neighbours below, above, and at the two sides already passed, how many are occupied, 0 to 3."""
    sides = _holds(parents, x - 1, y, z) | _holds(parents, x, y - 1, z)
    return _holds(parents, x, y, z - 1) + _holds(parents, x, y, z + 1) + sides
