"""The voxels around the neural points that a surface can pass, and their corners (paper III-C).

Corners are bits: a piece of 64 corners one above the other is one number, found in a table of voxels whose z counts
pieces. What belongs to a cell is then read for several cells at once.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import loop
from revisit.core.kernels.voxel_table import VoxelTable, add_to, find_in

NEAR_PLANE = 0.9
PIECE = 64
_WINDOW = 4  # corners along each edge of the 27 voxels around a point

Bits = NDArray[np.uint64]


@loop
def enter_observed_corners(
    positions: NDArray[np.float32], resolution: float, reach: float, pieces: VoxelTable, bits: Bits
) -> int:
    """Set the bits of the voxel corners within `reach` metres of any of `positions` (n, 3); returns how many pieces.

    Corner (x, y, z) lies at (x, y, z) * resolution; it is bit z & 63 of the piece (x, y, z >> 6). `pieces` and `bits`
    have room for all, 2 (2 ceil(reach / resolution))^2 n.
    """
    slots, following, voxels = pieces.slots, pieces.following, pieces.voxels
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
                for z in range(vz - steps + 1, vz + steps + 1):
                    dz = pz - np.float32(z * resolution)
                    if level + dz * dz > limit:
                        continue
                    if row < 0 or z >> 6 != height:
                        height = z >> 6
                        row = find_in(slots, following, voxels, x, y, height)
                        if row < 0:
                            row = count
                            count += 1
                            add_to(slots, following, voxels, row, x, y, height)
                            bits[row] = np.uint64(0)
                    bits[row] |= np.uint64(1) << np.uint64(z & 63)
    return count


@numba.njit(cache=True, error_model="numpy")
def list_corners(pieces: VoxelTable, bits: Bits, count: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The corners (n, 3) of the first `count` pieces, and the first corner (count,) of each piece."""
    first, total = np.empty(count, dtype=np.int32), 0
    for row in range(count):
        first[row] = total
        total += _ones(bits[row])
    corners, n = np.empty((total, 3), dtype=np.int32), 0
    for row in range(count):
        left, z = bits[row], pieces.voxels[row, 2] * PIECE
        while left:
            if left & np.uint64(1):
                corners[n, 0], corners[n, 1], corners[n, 2] = pieces.voxels[row, 0], pieces.voxels[row, 1], z
                n += 1
            left >>= np.uint64(1)
            z += 1
    return corners, first


def find_cells(
    positions: NDArray[np.float32], normals: NDArray[np.float32], resolution: float, pieces: VoxelTable, bits: Bits,
    first: NDArray[np.int32], most: int,
) -> NDArray[np.int32]:  # fmt: skip
    """The voxels among the 27 around each of `positions` (n, 3) that its tangent plane comes near, in this order.

    Near: the centre lies within 0.9 edges of the plane. Voxels without all eight corners among the `most` corners are
    left out. Returns the rows (m, 8) of each voxel's corners, corner c at + (c & 1, c >> 1 & 1, c >> 2 & 1).
    """
    rows, tried = np.empty((most, 8), dtype=np.int32), np.zeros(len(first), dtype=np.uint64)
    around, window = np.empty((2, _WINDOW, _WINDOW), np.int64), np.empty((_WINDOW, _WINDOW), np.int64)
    count = _find(positions, normals, resolution, pieces, bits, first, tried, around, window, rows)
    return rows[:count].copy()


@loop
def _find(
    positions: NDArray[np.float32], normals: NDArray[np.float32], resolution: float, pieces: VoxelTable, bits: Bits,
    first: NDArray[np.int32], tried: Bits, around: NDArray[np.int64], window: NDArray[np.int64],
    rows: NDArray[np.int32],
) -> int:  # fmt: skip
    """Fill `rows`; `tried`, 0 for each piece, `around` and `window` are for its use. Returns how many cells."""
    found, reach = 0, NEAR_PLANE * resolution
    slots, following, voxels = pieces.slots, pieces.following, pieces.voxels
    for i in range(len(positions)):
        px, py, pz = positions[i, 0], positions[i, 1], positions[i, 2]
        vx, vy, vz = int(np.floor(px / resolution)), int(np.floor(py / resolution)), int(np.floor(pz / resolution))
        shift = (vz - 1) & 63
        _read_window(slots, following, voxels, bits, vx - 1, vy - 1, vz - 1, around, window)
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


@numba.njit(inline="always")
def _read_window(
    slots: NDArray[np.int32], following: NDArray[np.int32], voxels: NDArray[np.int32], bits: Bits,
    x0: int, y0: int, z0: int, around: NDArray[np.int64], window: NDArray[np.int64],
) -> None:  # fmt: skip
    """Note which corners from (x0, y0, z0) on there are, as bits by z, and the rows of the pieces that hold them."""
    low, shift = z0 >> 6, z0 & 63
    for a in range(_WINDOW):
        for b in range(_WINDOW):
            row = find_in(slots, following, voxels, x0 + a, y0 + b, low)
            around[0, a, b] = row
            window[a, b] = np.int64((bits[row] >> np.uint64(shift)) & np.uint64(15)) if row >= 0 else 0
            if shift > PIECE - _WINDOW:
                row = find_in(slots, following, voxels, x0 + a, y0 + b, low + 1)
                around[1, a, b] = row
                if row >= 0:
                    window[a, b] |= np.int64((bits[row] << np.uint64(PIECE - shift)) & np.uint64(15))


@numba.njit(inline="always")
def _ones(word: np.uint64) -> int:
    """How many bits of 64 are set. Source: Warren, Hacker's Delight, 5-1."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return int((word * np.uint64(0x0101010101010101)) >> np.uint64(56))
