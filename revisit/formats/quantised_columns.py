"""The columns of a quantised cloud, summed up in one pass: a service decodes every scan of every robot."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]


@njit(nogil=True, cache=True)
def coordinates(planes: Bytes, count: int, step_m: float) -> NDArray[np.float32]:
    """Points (count, 3) in metres of three columns of zigzag-coded differences, four byte planes of `count` each."""
    points = np.empty((count, 3), dtype=np.float32)
    for axis in range(3):
        first, second = np.uint64(4 * axis * count), np.uint64((4 * axis + 1) * count)
        third, fourth = np.uint64((4 * axis + 2) * count), np.uint64((4 * axis + 3) * count)
        total = np.int64(0)  # of 32 bits each: nothing overflows
        for row in range(np.uint64(count)):
            low = np.uint32(planes[first + row]) | np.uint32(planes[second + row]) << np.uint32(8)
            high = np.uint32(planes[third + row]) << np.uint32(16) | np.uint32(planes[fourth + row]) << np.uint32(24)
            total += _unfolded(low | high)
            points[row, axis] = total * step_m
    return points


@njit(nogil=True, cache=True)
def intensities(planes: Bytes, count: int, step: float) -> NDArray[np.float32]:
    """Intensities (count,) of a column of zigzag-coded differences modulo 2^16, two byte planes of `count` each."""
    found = np.empty(count, dtype=np.float32)
    total = np.int64(0)
    for row in range(np.uint64(count)):
        total += _unfolded(np.uint32(planes[row]) | np.uint32(planes[np.uint64(count) + row]) << np.uint32(8))
        found[row] = (total & 0xFFFF) * step
    return found


@njit(inline="always")
def _unfolded(coded: np.uint32) -> np.int32:
    """Zigzag: 2 d for d >= 0, else -2 d - 1. Its lowest bit says whether all others are to be turned."""
    return np.int32(coded >> np.uint32(1)) ^ -np.int32(coded & np.uint32(1))
