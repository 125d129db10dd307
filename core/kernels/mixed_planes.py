"""Tangent planes of voxels as a stream of bits, each guessed by several models from the planes around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, inner, loop
from revisit.core.kernels.mixed_coder import SLOTS, WAYS, Mixture, code_mixed_bit, code_mixed_number, fresh_mixture
from revisit.core.kernels.plane_coder import (
    FIXED,
    HIT_CLASSES,
    SPREADS,
    guessed_offset,
    typical_normal,
)  # fmt: skip
from revisit.core.kernels.range_coder import Coder
from revisit.core.kernels.voxel_families import VoxelFamilies, coded_neighbours

_TURNS = 9  # differences of two codes: -4 to 4
_SIDE = 256  # codes of normals
_FEW = 8
_WEIGHTS = 64
_LONGEST = 16
# where the contexts of each way begin, in steps of SLOTS models
_FIRST = np.cumsum([0, SPREADS, SPREADS * _TURNS * _TURNS, SPREADS * _SIDE, 16 * 16])
_SECOND = _FIRST[-1] + np.cumsum(
    [_FEW * _TURNS, SPREADS * 3, SPREADS * _TURNS * 15, SPREADS * _SIDE * 5, 16 * 16]
)  # fmt: skip
_OFFSET = _SECOND[-1] + np.cumsum(
    [_FEW * _TURNS * 5, SPREADS, SPREADS * SPREADS * 4, 2 * _LONGEST + 1, _FEW * _WEIGHTS]
)  # fmt: skip
_HITS = _OFFSET[-1] + np.cumsum([3 * SPREADS * _TURNS, 1, 16, 64, 32])
_MODELS = int(_HITS[-1] + SPREADS * 32) * SLOTS
_SETS = (SPREADS + 3 * SPREADS + SPREADS + 1) * SLOTS

Whole = NDArray[np.int32]


def code_mixed_planes(
    coder: Coder, data: NDArray[np.uint8], families: VoxelFamilies, codes: Whole, vectors: Whole, steps: int,
    normal_unit: int, offset_unit: int,
) -> None:  # fmt: skip
    """Write `codes` (n, 4), or read and fill them: octahedral normal (2), offset along it, class of hits.

    As `code_planes`, but a normal is written as steps of `normal_unit` codes from a neighbour's, of two alike the
    smaller. Where that turns it, `codes` become what will be read: the plane goes through the point of it that is
    nearest the voxel's centre, as it did.
    """
    units = np.array([steps, normal_unit, offset_unit])
    mixture = fresh_mixture(_MODELS, _SETS)
    _code_all(coder, data, mixture, families, codes, vectors, units, np.zeros(4, np.int64))


@loop
def _code_all(
    coder: Coder, data: NDArray[np.uint8], mixture: Mixture, families: VoxelFamilies, codes: Whole, vectors: Whole,
    units: NDArray[np.int64], known: NDArray[np.int64],
) -> None:  # fmt: skip
    """As `code_mixed_planes`; `known` (4,) is for use here."""
    near = families.near
    for row in range(len(codes)):
        count = coded_neighbours(families, row)
        a, b = codes[row, 0], codes[row, 1]
        spread = _code_normal(coder, data, mixture, codes, units, near, count, row, known)
        if a != codes[row, 0] or b != codes[row, 1]:
            codes[row, 2] = turned(codes[row, 2], vectors[a, b], vectors[codes[row, 0], codes[row, 1]])
        _code_offset(coder, data, mixture, families, codes, vectors, units[2], count, row, known)
        _code_hits(coder, data, mixture, codes, near, count, row, spread)


@inlined
def turned(offset: int, before: Whole, after: Whole) -> int:
    """The offset of a plane through the foot of another, whose normal was `before`."""
    alike = before[0] * after[0] + before[1] * after[1] + before[2] * after[2]
    return int((2 * offset * alike + FIXED * FIXED) // (2 * FIXED * FIXED))


@inner
def _code_normal(
    coder: Coder, data: NDArray[np.uint8], mixture: Mixture, codes: Whole, units: NDArray[np.int64], near: Whole,
    count: int, row: int, known: NDArray[np.int64],
) -> int:  # fmt: skip
    """Code the normal; returns how far the neighbours' normals spread. `known` becomes (spread, turned by)."""
    steps, unit, at = units[0], units[1], mixture.at
    a, b, c, d, spread = steps, steps, steps, steps, SPREADS - 1
    if count > 0:
        typical, spread = typical_normal(codes, near, count, steps)
        other = near[1] if near[0] == typical and count > 1 else near[0]
        a, b, c, d = codes[typical, 0], codes[typical, 1], codes[other, 0], codes[other, 1]
    aside, beyond, few, towards = clipped(c - a, 4), clipped(d - b, 4), min(count, _FEW - 1), facing(a, b, steps)
    at[0] = _FIRST[0] + spread
    at[1] = _FIRST[1] + (spread * _TURNS + aside) * _TURNS + beyond
    at[2] = _FIRST[2] + spread * _SIDE + a
    at[3] = _FIRST[3] + towards
    at[4] = _FIRST[4] + few * _TURNS + aside
    first = _code_steps(coder, data, mixture, spread, steps_of(codes[row, 0] - a, unit))
    turn, size = clipped(first, 2), min(abs(first), 2)
    at[0] = _SECOND[0] + spread * 3 + size
    at[1] = _SECOND[1] + ((spread * _TURNS + beyond) * 5 + turn) * 3 + clipped(c - a, 1)
    at[2] = _SECOND[2] + (spread * _SIDE + b) * 5 + turn
    at[3] = _SECOND[3] + towards
    at[4] = _SECOND[4] + (few * _TURNS + beyond) * 5 + turn
    second = _code_steps(coder, data, mixture, SPREADS + spread * 3 + size, steps_of(codes[row, 1] - b, unit))
    codes[row, 0] = min(max(a + first * unit, 0), 2 * steps)
    codes[row, 1] = min(max(b + second * unit, 0), 2 * steps)
    known[0], known[1] = spread, min(abs(first) + abs(second), 3)
    return int(spread)


@inner
def _code_offset(
    coder: Coder, data: NDArray[np.uint8], mixture: Mixture, families: VoxelFamilies, codes: Whole, vectors: Whole,
    unit: int, count: int, row: int, known: NDArray[np.int64],
) -> None:  # fmt: skip
    """Code the offset; `known` is that of `_code_normal`."""
    parts, spread, weights = guessed_offset(families.voxels, families.near, codes, vectors, row, count, unit)
    guess, at = (parts + unit // 2) // unit, mixture.at
    at[0] = _OFFSET[0] + spread
    at[1] = _OFFSET[1] + (spread * SPREADS + known[0]) * 4 + known[1]
    at[2] = _OFFSET[2] + clipped(guess, _LONGEST)
    at[3] = _OFFSET[3] + min(count, _FEW - 1) * _WEIGHTS + min(weights, _WEIGHTS - 1)
    rest = clipped(8 * (parts - guess * unit) // unit, 4)
    at[4] = _OFFSET[4] + (steepest(vectors[codes[row, 0], codes[row, 1]]) * SPREADS + spread) * _TURNS + rest
    codes[row, 2] = guess + _code_steps(coder, data, mixture, 4 * SPREADS + spread, codes[row, 2] - guess)


@inner
def _code_hits(
    coder: Coder, data: NDArray[np.uint8], mixture: Mixture, codes: Whole, near: Whole, count: int, row: int,
    spread: int,
) -> None:  # fmt: skip
    """The class of hits, guessed from those of the nearest neighbours: one bit for each class below it."""
    a, b, c, mean = nearest_hits(codes, near, count)
    at = mixture.at
    at[0] = _HITS[0] * SLOTS
    at[1] = (_HITS[1] + a * HIT_CLASSES + b) * SLOTS
    at[2] = (_HITS[2] + (a * HIT_CLASSES + b) * HIT_CLASSES + c) * SLOTS
    at[3] = (_HITS[3] + mean) * SLOTS
    at[4] = (_HITS[4] + spread * 32 + mean) * SLOTS
    value = 0
    while value < HIT_CLASSES - 1:
        if code_mixed_bit(coder, data, mixture, value, 5 * SPREADS * SLOTS + value, 1 if codes[row, 3] == value else 0):
            break
        value += 1
    codes[row, 3] = value


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
def _code_steps(coder: Coder, data: NDArray[np.uint8], mixture: Mixture, which: int, value: int) -> int:
    """A number by the contexts `mixture.at`, in a class of numbers of its own."""
    for k in range(WAYS):
        mixture.at[k] *= SLOTS
    return int(code_mixed_number(coder, data, mixture, which * SLOTS, value))


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
