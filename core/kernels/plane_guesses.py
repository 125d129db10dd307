"""Guesses of a tangent plane from the planes around it that are already coded, and differences from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, inner

FIXED = 1024
"""Parts of a voxel's edge, and of a unit vector, in which guesses are computed: whole numbers on every machine."""
HIT_CLASSES = 4
SPREADS = 8
"""Classes of how far guesses spread; the last is for no guess."""
Whole = NDArray[np.int32]


@inner
def typical_normal(codes: Whole, near: Whole, count: int, steps: int) -> tuple[int, int]:
    """The row of `near` whose normal is least far from those of all, and a class of how far they spread; count >= 1."""
    best, least = most_typical(codes, near, count)
    # 63 steps of a code are about as wide as 16 steps of 4
    mean = 16 * least // (count * steps)
    return best, 1 + min(_size(mean), 5) if count > 1 else 0


@inner
def most_typical(codes: Whole, near: Whole, count: int) -> tuple[int, int]:
    """The one of the `count` >= 1 rows `near` whose code is least far from those of all, and how far on the whole."""
    best, least = near[0], 1 << 30
    for i in range(count):
        total = 0
        for j in range(count):
            total += abs(codes[near[i], 0] - codes[near[j], 0]) + abs(codes[near[i], 1] - codes[near[j], 1])
            if total >= least:
                break
        if total < least:
            best, least = near[i], total
    return best, least


@inner
def _size(value: int) -> int:
    """0 for 0, else one more than the whole logarithm to base 2."""
    size = 0
    while value > 0:
        value >>= 1
        size += 1
    return size


@inner
def guessed_offset(
    voxels: Whole, near: Whole, codes: Whole, vectors: Whole, row: int, count: int, unit: int
) -> tuple[int, int, int]:
    """The offset that continues the planes of the first `count` rows `near`, in parts of FIXED, a class of how well
    they agree with each other, and how much they weigh: the more, the better they agree with the row's normal.
    """
    normal = vectors[codes[row, 0], codes[row, 1]]
    total, weights, first, last = 0, 0, 1 << 30, -(1 << 30)
    for k in range(count):
        other = near[k]
        theirs = vectors[codes[other, 0], codes[other, 1]]
        agreement, mine, their = 0, 0, 0
        for axis in range(3):
            step = voxels[other, axis] - voxels[row, axis]
            agreement += normal[axis] * theirs[axis]
            mine += normal[axis] * step
            their += theirs[axis] * step
        agreement //= FIXED
        if agreement < 3 * FIXED // 10:
            continue
        offset = codes[other, 2] * unit
        # their plane at this voxel, and this voxel's normal through their point
        guess = (their + offset + mine + agreement * offset // FIXED) // 2
        weight = 8 if agreement > 9 * FIXED // 10 else 3 if agreement > 7 * FIXED // 10 else 1
        total += weight * guess
        weights += weight
        first, last = min(first, guess), max(last, guess)
    if weights == 0:
        return 0, SPREADS - 1, 0
    spread = min(_size((last - first) // 32), 4) + 1 if count > 1 else 0
    return total // weights, spread, weights


@inlined
def turned(offset: int, before: Whole, after: Whole) -> int:
    """The offset of a plane through the foot of another, whose normal was `before`."""
    alike = before[0] * after[0] + before[1] * after[1] + before[2] * after[2]
    return int((2 * offset * alike + FIXED * FIXED) // (2 * FIXED * FIXED))


@inlined
def nearest_hits(codes: Whole, near: Whole, count: int) -> tuple[int, int, int, int]:
    """The classes of hits of the first three of `count` rows `near`, and eight times the mean of the first eight."""
    a = codes[near[0], 3] if count > 0 else HIT_CLASSES - 1
    b = codes[near[1], 3] if count > 1 else HIT_CLASSES - 1
    c = codes[near[2], 3] if count > 2 else HIT_CLASSES - 1
    some, mean = min(count, 8), 0
    for k in range(some):
        mean += codes[near[k], 3]
    mean = (8 * mean + some // 2) // some if some > 0 else 30
    return a, b, c, mean


@inlined
def steps_of(difference: int, unit: int) -> int:
    """How many times `unit`; half a unit is none."""
    size = (2 * abs(difference) + unit - 1) // (2 * unit)
    return size if difference >= 0 else -size


@inlined
def clipped(difference: int, most: int) -> int:
    """A difference of at most `most` as a number from 0 on."""
    return min(max(difference, -most), most) + most


@inlined
def facing(a: int, b: int, steps: int) -> int:
    """One of 16 x 16 directions."""
    return 16 * (a * 15 // (2 * steps)) + b * 15 // (2 * steps)


@inlined
def steepest(normal: Whole) -> int:
    """The axis that a normal is nearest to."""
    x, y, z = abs(normal[0]), abs(normal[1]), abs(normal[2])
    return 0 if x >= y and x >= z else 1 if y >= z else 2
