"""Voxels by the node of an octree that they lie in: the neighbours of one are in eight nodes, not in 26 places."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, loop

Whole = NDArray[np.int32]

_NEXT, _FIRST, _MASK = 3, 4, 5
_X, _Y, _Z = 0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D


class VoxelFamilies(NamedTuple):
    """Voxels (n, 3) in the order of an octree, and its lowest nodes but one.

    own (n,) is the node of each voxel; nodes (p, 6) are x, y, z, the next node of the same slot, the row of the first
    of its voxels, and which of its eight children are voxels, a bit each. slots hold the first node of each chain, by
    sums of coordinates times constants: the slot of a neighbour is a sum away.

    For use while one voxel is coded: near (27,), rows of neighbours, and last which of the six voxels that share a face
    with it exist, a bit each, before it along x, y, z and then behind; ranks (26,), the sorting key of the rows.
    """

    voxels: Whole
    own: Whole
    nodes: Whole
    slots: Whole
    near: Whole
    ranks: Whole


def _neighbours() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """For each child of a node, each of the eight nodes around and each of its children: the rank of that voxel among
    the 26 neighbours, those that share a face first, then an edge, then a corner; and which voxels have one, as masks.
    """
    side = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    steps = side[np.argsort(np.abs(side).sum(axis=1), kind="stable")][1:]
    child = np.stack(np.meshgrid(*[np.arange(2)] * 3, indexing="ij"), axis=-1).reshape(8, 1, 3)
    at, bits = child + steps, np.array([4, 2, 1])
    node, inside = ((at < 0) | (at > 1)) @ bits, (at & 1) @ bits
    own, rank = np.indices(node.shape)
    ranks, reached = np.full((8, 8, 8), 26, dtype=np.uint8), np.zeros((8, 8), dtype=np.uint8)
    ranks[own, node, inside] = rank
    np.bitwise_or.at(reached, (own, node), (1 << inside).astype(np.uint8))
    return ranks, reached


_RANK, _REACHED = _neighbours()
_FACE = np.array([1, 2, 4, 32, 16, 8, *[0] * 20], dtype=np.uint8)
"""The bit of each neighbour in `beside`."""
_ONES = np.array([number.bit_count() for number in range(256)], dtype=np.uint8)
_LOWEST = np.array([max((number & -number).bit_length() - 1, 0) for number in range(256)], dtype=np.uint8)


def families_of(voxels: Whole) -> VoxelFamilies:
    """The families of voxels (n, 3) in 0..2^30, distinct and in the order of an octree."""
    count, slots = len(voxels), 1 << max(6, (2 * len(voxels)).bit_length() - 1)
    own, nodes = np.empty(count, np.int32), np.zeros((count, 6), np.int32)
    slot, near = np.full(slots, -1, np.int32), np.zeros(27, np.int32)
    families = VoxelFamilies(voxels, own, nodes, slot, near, np.zeros(26, np.int32))
    _fill(families)
    return families


@loop
def _fill(families: VoxelFamilies) -> None:
    voxels, nodes = families.voxels, families.nodes
    node = -1
    for row in range(len(voxels)):
        x, y, z = voxels[row, 0] >> 1, voxels[row, 1] >> 1, voxels[row, 2] >> 1
        if node < 0 or nodes[node, 0] != x or nodes[node, 1] != y or nodes[node, 2] != z:
            node += 1
            slot = (x * _X + y * _Y + z * _Z) & (len(families.slots) - 1)
            nodes[node, 0], nodes[node, 1], nodes[node, 2] = x, y, z
            nodes[node, _NEXT], nodes[node, _FIRST] = families.slots[slot], row
            families.slots[slot] = node
        nodes[node, _MASK] |= 1 << (4 * (voxels[row, 0] & 1) + 2 * (voxels[row, 1] & 1) + (voxels[row, 2] & 1))
        families.own[row] = node


@inlined
def beside(families: VoxelFamilies) -> int:
    """Which of the six voxels that share a face with the one looked at exist, coded before it or not."""
    return int(families.near[26])


@loop
def coded_neighbours(families: VoxelFamilies, row: int) -> int:
    """How many of the 26 voxels around a row's come before it: `families.near` becomes their rows, those that share a
    face first.
    """
    nodes, slots, near = families.nodes, families.slots, families.near
    x, y, z = families.voxels[row]
    own = 4 * (x & 1) + 2 * (y & 1) + (z & 1)
    dx, dy, dz = 2 * (x & 1) - 1, 2 * (y & 1) - 1, 2 * (z & 1) - 1
    x, y, z = x >> 1, y >> 1, z >> 1
    key, last, count, faces = x * _X + y * _Y + z * _Z, len(slots) - 1, 0, 0
    for k in range(8):
        ax, ay, az = dx * (k >> 2), dy * (k >> 1 & 1), dz * (k & 1)
        node = slots[(key + ax * _X + ay * _Y + az * _Z) & last]
        while node >= 0 and (nodes[node, 0] != x + ax or nodes[node, 1] != y + ay or nodes[node, 2] != z + az):
            node = nodes[node, _NEXT]
        reached = nodes[node, _MASK] & _REACHED[own, k] if node >= 0 else 0
        while reached:
            child = _LOWEST[reached]
            reached &= reached - 1
            rank = _RANK[own, k, child]
            faces |= _FACE[rank]
            other = nodes[node, _FIRST] + _ONES[nodes[node, _MASK] & ((1 << child) - 1)]
            if other < row:
                _insert(near, families.ranks, count, other, rank)
                count += 1
    near[26] = faces
    return count


@inlined
def _insert(near: Whole, ranks: Whole, count: int, row: int, rank: int) -> None:
    """Put a row behind those of a lower rank."""
    while count > 0 and ranks[count - 1] > rank:
        near[count], ranks[count] = near[count - 1], ranks[count - 1]
        count -= 1
    near[count], ranks[count] = row, rank
