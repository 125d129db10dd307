"""The neighbours of voxels and of an octree's nodes by their parents': counted from masks of children, not searched."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, loop

Whole = NDArray[np.int32]

NEIGHBOURS = 26


class OctreeLevel(NamedTuple):
    """Voxels (n, 3) of one level of an octree in their order, and the nodes above them.

    own (n,) is the node of each voxel. Of the p nodes: around (p, 26), the nodes beside them in the order of STEPS, or
    -1; first (p,), the row of the first voxel of each; masks (p,), which of its eight children are voxels, a bit each.
    """

    voxels: Whole
    own: Whole
    around: Whole
    first: Whole
    masks: Whole


def _steps() -> NDArray[np.int64]:
    side = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.ascontiguousarray(side[np.argsort(np.abs(side).sum(axis=1), kind="stable")][1:])


STEPS = _steps()
"""The steps (26, 3) to the voxels around one: those that share a face with it first, then an edge, then a corner."""


def _children_around() -> tuple[NDArray[np.int64], NDArray[np.uint8], NDArray[np.uint8]]:
    """For each child of a node the eight nodes that the voxels around it lie in, first its own: where they are among
    the 26 around that, itself as 26; and for each of their children where that voxel is in STEPS, else 26, and which
    have such a place, as masks.
    """
    child = np.stack(np.meshgrid(*[np.arange(2)] * 3, indexing="ij"), axis=-1).reshape(8, 1, 3)
    at, bits = child + STEPS, np.array([4, 2, 1])
    which, inside = ((at < 0) | (at > 1)) @ bits, (at & 1) @ bits
    own, step = np.indices(which.shape)
    place = np.full(27, NEIGHBOURS)
    place[(STEPS + 1) @ [9, 3, 1]] = np.arange(NEIGHBOURS)
    places = np.full((8, 8), NEIGHBOURS)
    places[own, which] = place[((at >> 1) + 1) @ [9, 3, 1]]
    ranks, reached = np.full((8, 8, 8), NEIGHBOURS, dtype=np.uint8), np.zeros((8, 8), dtype=np.uint8)
    ranks[own, which, inside] = step
    np.bitwise_or.at(reached, (own, which), (1 << inside).astype(np.uint8))
    return places, ranks, reached


PLACES, _RANKS, _REACHED = _children_around()
_ONES = np.array([number.bit_count() for number in range(256)], dtype=np.uint8)
_LOWEST = np.array([max((number & -number).bit_length() - 1, 0) for number in range(256)], dtype=np.uint8)


def _spread_masks() -> NDArray[np.int32]:
    """For each child, each of its eight nodes and each mask of that node's children: which voxels around the child they
    are, as a mask of 26 bits in the order of STEPS.
    """
    bits = np.where(_RANKS < NEIGHBOURS, 1 << (_RANKS.astype(np.int64) % NEIGHBOURS), 0)
    masks = np.arange(256)[:, None] >> np.arange(8) & 1
    spread: NDArray[np.int32] = np.einsum("cni,mi->cnm", bits, masks).astype(np.int32)
    return spread


AROUND = _spread_masks()


def top_level() -> OctreeLevel:
    """The root as the only voxel."""
    alone = np.full((1, NEIGHBOURS), -1, np.int32)
    return OctreeLevel(
        np.zeros((1, 3), np.int32), np.zeros(1, np.int32), alone, np.zeros(1, np.int32), np.ones(1, np.int32)
    )


def neighbours_of_all(level: OctreeLevel) -> Whole:
    """The rows (n, 26) of the voxels around each of a level, -1 where there is none."""
    around = np.empty((len(level.voxels), NEIGHBOURS), np.int32)
    _list_all(level, around)
    return around


@loop
def _list_all(level: OctreeLevel, around: Whole) -> None:
    for row in range(len(around)):
        list_neighbours(level, row, around[row])


@inlined
def list_neighbours(level: OctreeLevel, row: int, found: Whole) -> None:
    """Fill `found` (26,) with the rows of the voxels around that of `row`, -1 where there is none."""
    x, y, z = level.voxels[row, 0], level.voxels[row, 1], level.voxels[row, 2]
    child, own = 4 * (x & 1) + 2 * (y & 1) + (z & 1), level.own[row]
    for k in range(NEIGHBOURS):
        found[k] = -1
    for k in range(8):
        node = own if k == 0 else level.around[own, PLACES[child, k]]
        if node < 0:
            continue
        mask, first = level.masks[node], level.first[node]
        reached = mask & _REACHED[child, k]
        while reached:
            inside = _LOWEST[reached]
            reached &= reached - 1
            found[_RANKS[child, k, inside]] = first + _ONES[mask & ((1 << inside) - 1)]
