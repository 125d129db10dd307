"""Tangent planes of voxels as a stream of bits: each is guessed from the planes around it that are already coded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inner, loop
from revisit.core.kernels.range_coder import UNARY, Coder, Models, code_bit, code_number
from revisit.core.kernels.voxel_families import VoxelFamilies, coded_neighbours

FIXED = 1024
"""Parts of a voxel's edge, and of a unit vector, in which guesses are computed: whole numbers on every machine."""
HIT_CLASSES = 4
SPREADS = 8
"""Classes of how far guesses spread; the last is for no guess."""
_FIRST_NORMAL = 0
_SECOND_NORMAL = _FIRST_NORMAL + SPREADS * UNARY
_OFFSET = _SECOND_NORMAL + SPREADS * 3 * UNARY
_HITS = _OFFSET + 2 * SPREADS * UNARY
PLANE_MODELS = _HITS + 64 * HIT_CLASSES

Whole = NDArray[np.int32]


@loop
def code_planes(
    coder: Coder, data: NDArray[np.uint8], models: Models, families: VoxelFamilies, codes: Whole, vectors: Whole,
    steps: int, offset_unit: int,
) -> None:  # fmt: skip
    """Write `codes` (n, 4), or read and fill them: octahedral normal (2), offset along it, class of hits.

    `families` are those of the voxels, which are coded in their order. vectors[i, j] (3,) is the normal of codes i, j
    in parts of FIXED; codes run to 2 * `steps`. An offset counts units of `offset_unit` parts of FIXED of a
    voxel's edge.
    """
    near = families.near
    for row in range(len(codes)):
        count = coded_neighbours(families, row)
        a, b, spread = steps, steps, SPREADS - 1
        if count > 0:
            guess, spread = typical_normal(codes, near, count, steps)
            a, b = codes[guess, 0], codes[guess, 1]
        first = code_number(coder, data, models, _FIRST_NORMAL + spread * UNARY, codes[row, 0] - a)
        model = _SECOND_NORMAL + (3 * spread + min(abs(first), 2)) * UNARY
        codes[row, 0] = min(max(a + first, 0), 2 * steps)
        codes[row, 1] = min(max(b + code_number(coder, data, models, model, codes[row, 1] - b), 0), 2 * steps)
        parts, spread, _ = guessed_offset(families.voxels, near, codes, vectors, row, count, offset_unit)
        guess = (parts + offset_unit // 2) // offset_unit
        model = _OFFSET + spread * UNARY
        codes[row, 2] = guess + code_number(coder, data, models, model, codes[row, 2] - guess)
        _code_hits(coder, data, models, codes, row, near, count)


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


@inner
def _code_hits(
    coder: Coder, data: NDArray[np.uint8], models: Models, codes: Whole, row: int, near: Whole, count: int
) -> None:
    """The class of hits, guessed from the two nearest neighbours: one bit for each class below it."""
    a = codes[near[0], 3] if count > 0 else HIT_CLASSES - 1
    b = codes[near[1], 3] if count > 1 else HIT_CLASSES - 1
    value = 0
    while value < HIT_CLASSES - 1:
        model = _HITS + ((a * HIT_CLASSES + b) * HIT_CLASSES + value)
        if code_bit(coder, data, models, model, 1 if codes[row, 3] == value else 0):
            break
        value += 1
    codes[row, 3] = value
