"""A hash table of voxels with chains: each voxel is found, also where others have its slot.

Voxels of one column (x, y) lie side by side in the table, so that a search through neighbours touches few cache lines.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import compiled, inlined, loop

MIN_BITS = 16
MAX_BITS = 24


class VoxelTable(NamedTuple):
    """Rows of voxels by hash, int32.

    slots (2^bits,) hold the first row of each chain, following (n,) the next one; -1 ends a chain. voxels (n, 3).
    """

    slots: NDArray[np.int32]
    following: NDArray[np.int32]
    voxels: NDArray[np.int32]


def empty_slots(rows: int) -> NDArray[np.int32]:
    """The slots of a table for so many rows: at least as many, but no fewer than 2^16 and no more than 2^24."""
    bits = min(max(MIN_BITS, (rows - 1).bit_length()), MAX_BITS)
    return np.full(1 << bits, -1, dtype=np.int32)


def voxels_of(positions: NDArray[np.floating], resolution: float) -> NDArray[np.int32]:
    """The voxels (n, 3) of edge `resolution` in which `positions` (n, 3) lie."""
    return np.floor(positions / np.float64(resolution)).astype(np.int32)


def table_of(voxels: NDArray[np.int32]) -> VoxelTable:
    """The table of `voxels` (n, 3); of equal ones the last is found."""
    table = VoxelTable(empty_slots(len(voxels)), np.full(len(voxels), -1, dtype=np.int32), voxels)
    _fill(table.slots, table.following, table.voxels)
    return table


def distinct_rows(voxels: NDArray[np.int32]) -> NDArray[np.int64]:
    """The first row of each of `voxels` (n, 3), ascending."""
    entered, rows = np.empty((len(voxels), 3), np.int32), np.empty(len(voxels), np.int64)
    following = np.empty(len(voxels), np.int32)
    return rows[: _enter_distinct(voxels, empty_slots(len(voxels)), following, entered, rows)]


@loop
def _enter_distinct(
    voxels: NDArray[np.int32], slots: NDArray[np.int32], following: NDArray[np.int32], entered: NDArray[np.int32],
    rows: NDArray[np.int64],
) -> int:  # fmt: skip
    """Fill `rows`; returns how many. The others are for its use, `slots` empty."""
    count = 0
    for n in range(len(voxels)):
        x, y, z = voxels[n, 0], voxels[n, 1], voxels[n, 2]
        if find_in(slots, following, entered, x, y, z) < 0:
            add_to(slots, following, entered, count, x, y, z)
            rows[count] = n
            count += 1
    return count


@inlined
def slot_of(slots: NDArray[np.int32], x: int, y: int, z: int) -> int:
    """The slot of voxel (x, y, z)."""
    column = (x & 0xFFFFF) * 0x9E3779B1 + (y & 0xFFFFF) * 0x85EBCA77
    column = (column ^ (column >> 15)) * 0x2C1B3C6D & 0x7FFFFFFF
    column = (column ^ (column >> 12)) * 0x297A2D39 & 0x7FFFFFFF
    return ((column ^ (column >> 15)) + z) & (len(slots) - 1)


@inlined
def find_in(
    slots: NDArray[np.int32], following: NDArray[np.int32], voxels: NDArray[np.int32], x: int, y: int, z: int
) -> int:
    """The row of voxel (x, y, z), or -1.

    Takes the arrays of a table one by one: a loop that takes them out of the table counts references at every step.
    """
    row: int = slots[slot_of(slots, x, y, z)]
    while row >= 0 and (voxels[row, 0] != x or voxels[row, 1] != y or voxels[row, 2] != z):
        row = following[row]
    return row


@inlined
def add_to(
    slots: NDArray[np.int32], following: NDArray[np.int32], voxels: NDArray[np.int32], row: int, x: int, y: int, z: int
) -> None:
    """Enter voxel (x, y, z), which is not in the table yet, as `row`."""
    slot = slot_of(slots, x, y, z)
    voxels[row, 0], voxels[row, 1], voxels[row, 2] = x, y, z
    following[row] = slots[slot]
    slots[slot] = row


@inlined
def find(table: VoxelTable, x: int, y: int, z: int) -> int:
    """The row of voxel (x, y, z), or -1. Loops over many voxels take `find_in`, which is several times faster."""
    return find_in(table.slots, table.following, table.voxels, x, y, z)


@inlined
def add(table: VoxelTable, row: int, x: int, y: int, z: int) -> None:
    """Enter voxel (x, y, z), which is not in the table yet, as `row`."""
    add_to(table.slots, table.following, table.voxels, row, x, y, z)


@loop
def _fill(slots: NDArray[np.int32], following: NDArray[np.int32], voxels: NDArray[np.int32]) -> None:
    for row in range(len(voxels) - 1, -1, -1):
        x, y, z = voxels[row, 0], voxels[row, 1], voxels[row, 2]
        if find_in(slots, following, voxels, x, y, z) < 0:
            add_to(slots, following, voxels, row, x, y, z)


@compiled
def rows_of(table: VoxelTable, voxels: NDArray[np.int32]) -> NDArray[np.int64]:
    """The rows (n,) of `voxels` (n, 3) in the table, -1 where one is not there."""
    slots, following, entered = table.slots, table.following, table.voxels
    rows = np.empty(len(voxels), dtype=np.int64)
    for n in range(len(voxels)):
        rows[n] = find_in(slots, following, entered, voxels[n, 0], voxels[n, 1], voxels[n, 2])
    return rows
