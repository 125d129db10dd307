"""The voxels around the neural points that a surface can pass, and their corners (paper III-C).

Corners are bits: a piece of 64 corners one above the other is one number. What belongs to a cell is then read for
several cells at once. A piece is found in a grid, which takes a fifth of the time of a hash table; where points lie so
far apart that most of the grid would be empty, in a table of voxels whose z counts pieces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import compiled, inlined, loop
from revisit.core.kernels.voxel_table import add_to, empty_slots, find_in

NEAR_PLANE = 0.9
PIECE = 64
_WINDOW = 4  # corners along each edge of the 27 voxels around a point

_PIECES_EACH = 2
"""Pieces of corners that a neural point may add before the hash table becomes slow."""
_PLACES_EACH = 48
"""Places of the grid for each neural point, at most."""

Bits = NDArray[np.uint64]
Rows = NDArray[np.int32]
Whole = NDArray[np.int64]


class Pieces(NamedTuple):
    """Room for pieces: `voxels` (n, 3) int32, x, y and z of 64 corners, and their `bits` (n,).

    A row is found by `grid`, int32 by x, y, z, `shape` (3,) places from `low` (3,) on, -1 where there is none; where
    that is empty by `slots` and `following`, as in a `VoxelTable`.
    """

    voxels: Rows
    bits: Bits
    grid: Rows
    low: Whole
    shape: Whole
    slots: Rows
    following: Rows


def pieces_around(positions: NDArray[np.float32], resolution: float, reach: float, each: int = _PLACES_EACH) -> Pieces:
    """Room for the pieces of all corners within `reach` metres of `positions` (n, 3). Unused rows take no memory.

    Memory grows with the number of positions, not with the volume between them: `each` places of the grid at most.
    """
    steps = int(np.ceil(reach / resolution))
    room = 2 * (2 * steps) ** 2 * len(positions)
    ends = np.stack([positions.min(axis=0, initial=np.inf), positions.max(axis=0, initial=-np.inf)])
    low, high = np.floor((ends if len(positions) else np.zeros((2, 3))) / np.float64(resolution)).astype(np.int64)
    low, high = low - max(steps, _WINDOW), high + max(steps, _WINDOW)
    low[2], high[2] = low[2] >> 6, high[2] >> 6
    shape = high - low + 1
    gridded = np.prod(shape, dtype=np.float64) <= each * len(positions)
    grid = np.full(int(np.prod(shape)) if gridded else 0, -1, np.int32)
    slots = empty_slots(0 if gridded else _PIECES_EACH * len(positions))
    return Pieces(
        np.empty((room, 3), np.int32), np.empty(room, np.uint64), grid, low, shape, slots,
        np.empty(0 if gridded else room, np.int32),
    )  # fmt: skip


@loop
def enter_observed_corners(positions: NDArray[np.float32], resolution: float, reach: float, pieces: Pieces) -> int:
    """Set the bits of the voxel corners within `reach` metres of any of `positions` (n, 3); returns how many pieces.

    Corner (x, y, z) lies at (x, y, z) * resolution; it is bit z & 63 of the piece (x, y, z >> 6).
    """
    slots, following, voxels, bits, grid = pieces.slots, pieces.following, pieces.voxels, pieces.bits, pieces.grid
    x_low, y_low, z_low, depth, levels = pieces.low[0], pieces.low[1], pieces.low[2], pieces.shape[1], pieces.shape[2]
    count, steps = 0, int(np.ceil(reach / resolution))
    limit = np.float32(reach) * np.float32(reach)
    for i in range(len(positions)):
        px, py, pz = positions[i, 0], positions[i, 1], positions[i, 2]
        vx, vy, vz = int(np.floor(px / resolution)), int(np.floor(py / resolution)), int(np.floor(pz / resolution))
        for x in range(vx - steps + 1, vx + steps + 1):
            dx = px - np.float32(x * resolution)
            for y in range(vy - steps + 1, vy + steps + 1):
                dy = py - np.float32(y * resolution)
                row, height, level = -1, 0, dx * dx + dy * dy
                if level > limit:
                    continue
                column = ((x - x_low) * depth + y - y_low) * levels - z_low
                for z in range(vz - steps + 1, vz + steps + 1):
                    dz = pz - np.float32(z * resolution)
                    if level + dz * dz > limit:
                        continue
                    if row < 0 or z >> 6 != height:
                        height = z >> 6
                        row = _row_of(grid, column + height, slots, following, voxels, x, y, height)
                        if row < 0:
                            row = count
                            count += 1
                            _enter(grid, column + height, slots, following, voxels, row, x, y, height)
                            bits[row] = np.uint64(0)
                    bits[row] |= np.uint64(1) << np.uint64(z & 63)
    return count


@inlined
def _row_of(grid: Rows, place: int, slots: Rows, following: Rows, voxels: Rows, x: int, y: int, z: int) -> int:
    """The row of piece (x, y, z), whose place in the grid is `place`, or -1."""
    return int(grid[np.uint64(place)]) if len(grid) else find_in(slots, following, voxels, x, y, z)


@inlined
def _enter(
    grid: Rows, place: int, slots: Rows, following: Rows, voxels: Rows, row: int, x: int, y: int, z: int
) -> None:
    """Enter piece (x, y, z), which is not there yet, as `row`."""
    if len(grid):
        grid[np.uint64(place)] = row
        voxels[row, 0], voxels[row, 1], voxels[row, 2] = x, y, z
    else:
        add_to(slots, following, voxels, row, x, y, z)


@compiled
def list_corners(pieces: Pieces, count: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The corners (n, 3) of the first `count` pieces, and the first corner (count,) of each piece."""
    bits = pieces.bits
    first, total = np.empty(count, dtype=np.int32), 0
    for row in range(count):
        first[row] = total
        total += _ones(bits[row])
    corners, n = np.empty((total, 3), dtype=np.int32), 0
    for row in range(count):
        left, z = bits[row], pieces.voxels[row, 2] * PIECE
        while left:
            lowest = left & (~left + np.uint64(1))
            corners[n, 0], corners[n, 1] = pieces.voxels[row, 0], pieces.voxels[row, 1]
            corners[n, 2] = z + _ones(lowest - np.uint64(1))
            n += 1
            left ^= lowest
    return corners, first


def find_cells(
    positions: NDArray[np.float32], normals: NDArray[np.float32], resolution: float, pieces: Pieces,
    first: NDArray[np.int32], most: int,
) -> NDArray[np.int32]:  # fmt: skip
    """The voxels among the 27 around each of `positions` (n, 3) that its tangent plane comes near, in this order.

    Near: the centre lies within 0.9 edges of the plane. Voxels without all eight corners among the `most` corners are
    left out. Returns the rows (m, 8) of each voxel's corners, corner c at + (c & 1, c >> 1 & 1, c >> 2 & 1).
    """
    rows, tried = np.empty((most, 8), dtype=np.int32), np.zeros(len(first), dtype=np.uint64)
    around, window = np.empty((2, _WINDOW, _WINDOW), np.int64), np.empty((_WINDOW, _WINDOW), np.int64)
    count = _find(positions, normals, resolution, pieces, first, tried, around, window, rows)
    return rows[:count].copy()


@loop
def _find(
    positions: NDArray[np.float32], normals: NDArray[np.float32], resolution: float, pieces: Pieces,
    first: NDArray[np.int32], tried: Bits, around: NDArray[np.int64], window: NDArray[np.int64],
    rows: NDArray[np.int32],
) -> int:  # fmt: skip
    """Fill `rows`; `tried`, 0 for each piece, `around` and `window` are for its use. Returns how many cells."""
    found, reach = 0, NEAR_PLANE * resolution
    slots, following, voxels, bits, grid = pieces.slots, pieces.following, pieces.voxels, pieces.bits, pieces.grid
    x_low, y_low, z_low, depth, levels = pieces.low[0], pieces.low[1], pieces.low[2], pieces.shape[1], pieces.shape[2]
    for i in range(len(positions)):
        px, py, pz = positions[i, 0], positions[i, 1], positions[i, 2]
        vx, vy, vz = int(np.floor(px / resolution)), int(np.floor(py / resolution)), int(np.floor(pz / resolution))
        shift, column = (vz - 1) & 63, ((vx - 1 - x_low) * depth + vy - 1 - y_low) * levels - z_low
        _read_window(
            grid, column, depth, levels, slots, following, voxels, bits, vx - 1, vy - 1, vz - 1, around, window
        )
        for a in range(_WINDOW - 1):
            height_a = ((vx + a - 0.5) * resolution - px) * normals[i, 0]
            for b in range(_WINDOW - 1):
                known = window[a, b] & window[a + 1, b] & window[a, b + 1] & window[a + 1, b + 1]
                known &= known >> 1
                height_b = height_a + ((vy + b - 0.5) * resolution - py) * normals[i, 1]
                for c in range(_WINDOW - 1):
                    height = height_b + ((vz + c - 0.5) * resolution - pz) * normals[i, 2]
                    if (known >> c) & 1 == 0 or abs(height) > reach:
                        continue
                    # a voxel is named by its lowest corner
                    named, bit = around[(shift + c) >> 6, a, b], np.uint64(1) << np.uint64((shift + c) & 63)
                    if tried[named] & bit:
                        continue
                    tried[named] |= bit
                    for corner in range(8):
                        z = shift + c + (corner >> 2)
                        owner = around[z >> 6, a + (corner & 1), b + (corner >> 1 & 1)]
                        below = bits[owner] & ((np.uint64(1) << np.uint64(z & 63)) - np.uint64(1))
                        rows[found, corner] = first[owner] + _ones(below)
                    found += 1
    return found


@inlined
def _read_window(
    grid: Rows, column: int, depth: int, levels: int, slots: Rows, following: Rows, voxels: Rows, bits: Bits,
    x0: int, y0: int, z0: int, around: Whole, window: Whole,
) -> None:  # fmt: skip
    """Note which corners from (x0, y0, z0) on there are, as bits by z, and the rows of the pieces that hold them.

    `column` is the place of piece (x0, y0, 0) in the grid of `depth` and `levels`.
    """
    low, shift = z0 >> 6, z0 & 63
    for a in range(_WINDOW):
        for b in range(_WINDOW):
            place = column + (a * depth + b) * levels + low
            row = _row_of(grid, place, slots, following, voxels, x0 + a, y0 + b, low)
            around[0, a, b] = row
            window[a, b] = np.int64((bits[row] >> np.uint64(shift)) & np.uint64(15)) if row >= 0 else 0
            if shift > PIECE - _WINDOW:
                row = _row_of(grid, place + 1, slots, following, voxels, x0 + a, y0 + b, low + 1)
                around[1, a, b] = row
                if row >= 0:
                    window[a, b] |= np.int64((bits[row] << np.uint64(PIECE - shift)) & np.uint64(15))


@inlined
def _ones(word: np.uint64) -> int:
    """How many bits of 64 are set. Source: Warren, Hacker's Delight, 5-1."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return int((word * np.uint64(0x0101010101010101)) >> np.uint64(56))
