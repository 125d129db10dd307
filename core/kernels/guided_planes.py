"""Tangent planes of voxels as a stream of bits, each guessed from the planes coded before it and all voxels around.

The hits come first. A normal is guessed as it was made: from where voxels lie around its own, and from the direction to
the middle of the map (docs/decisions/0287).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.expected_normals import (
    EXPECTED,
    FLATNESS,
    FLATNESSES,
    MEAN,
    NORMAL_A,
    NORMAL_B,
    OCCUPIED,
    VIEW_A,
    VIEW_B,
    expect_normal,
    settle_spot,
)
from revisit.core.kernels.loops import inlined, loop
from revisit.core.kernels.mixed_coder import SLOTS, WAYS, Mixture, mixed_bit
from revisit.core.kernels.mixed_octree import HEIGHTS, RANGES, range_class
from revisit.core.kernels.octree_nodes import NEIGHBOURS, OctreeLevel, list_neighbours
from revisit.core.kernels.plane_guesses import (
    FIXED,
    HIT_CLASSES,
    SPREADS,
    clipped,
    facing,
    guessed_offset,
    nearest_hits,
    steepest,
    steps_of,
    turned,
    typical_normal,
)
from revisit.core.kernels.range_coder import Coder, code_large

LONE = 4
"""A normal without a voxel around, mostly the rounding of one return, is written in so many times the unit."""
_GUESSES = 2
"""The last of the ways: their models tell the distance of the value from a guess."""
_TURNS = 9
_SIDE = 32
_FEW = 8
_OCCUPIED = 6
_LONGEST = 16
_NEAR = 8
_BESIDE = 5 * (2 * _NEAR + 1)  # models of a guess: zero, sign, size 1, 2, more; and how far away
_OTHER = WAYS - _GUESSES


def _places(begin: int, contexts: list[int], guesses: list[int]) -> NDArray[np.int64]:
    """Where the models of each way begin, and where those behind all of them."""
    sizes = [SLOTS * count for count in contexts] + [_BESIDE * count for count in guesses]
    return begin + np.cumsum([0, *sizes])


_FIRST = _places(
    0, [SPREADS * _TURNS * _TURNS, SPREADS * _SIDE, 16 * 16],
    [FLATNESSES * _OCCUPIED, _OCCUPIED * _FEW],
)  # fmt: skip
_SECOND = _places(
    int(_FIRST[-1]), [SPREADS * _TURNS * 15, SPREADS * _SIDE * 5, 16 * 16],
    [FLATNESSES * _OCCUPIED * 3, _OCCUPIED * _FEW * 3],
)  # fmt: skip
_OFFSET = _places(
    int(_SECOND[-1]), [SPREADS * SPREADS * 4, 2 * _LONGEST + 1, 3 * SPREADS * _TURNS],
    [FLATNESSES * _OCCUPIED, RANGES * HIT_CLASSES],
)  # fmt: skip
_HITS = _OFFSET[-1] + HIT_CLASSES * np.cumsum(
    [0, 64, _FEW * 32, RANGES * 27, RANGES * 32, HEIGHTS * RANGES]
)  # fmt: skip
PLANE_MODELS = int(_HITS[-1])
_HIT_SETS = (SPREADS + 3 * SPREADS + SPREADS) * SLOTS
PLANE_SETS = _HIT_SETS + _FEW * HIT_CLASSES

Whole = NDArray[np.int32]
Numbers = NDArray[np.int64]


class Scratch(NamedTuple):
    """For use while one voxel is coded: around (26,), the rows of all voxels around it; near (26,), of those coded
    before it; expected, as `expect_normal` fills it; base (WAYS,), where the contexts of a number begin; guesses
    (_GUESSES,), what it may be; spots (n, 3), where points lie in their voxels.
    """

    around: Whole
    near: Whole
    expected: Numbers
    base: Numbers
    guesses: Numbers
    spots: Whole


def code_guided_planes(
    coder: Coder, data: NDArray[np.uint8], mixture: Mixture, level: OctreeLevel, low: Numbers, codes: Whole,
    vectors: Whole, steps: int, normal_unit: int, offset_unit: int,
) -> None:  # fmt: skip
    """Write `codes` (n, 4) of the voxels of a `level`, or read and fill them: octahedral normal (2), offset along it,
    class of hits.

    vectors[i, j] (3,) is the normal of codes i, j in parts of FIXED; codes run to 2 * `steps`. An offset counts units
    of `offset_unit` parts of FIXED of a voxel's edge. A normal is written as steps of `normal_unit` codes from a
    neighbour's, of two alike the smaller. Where that turns it, `codes` become what will be read: the plane goes through
    the point of it that is nearest the voxel's centre, as it did. `low` (3,) is the voxel 0 of the level as seen from
    the middle of the map.
    """
    units = np.array([steps, normal_unit, offset_unit])
    scratch = Scratch(
        np.zeros(NEIGHBOURS, np.int32), np.zeros(NEIGHBOURS, np.int32), np.zeros(EXPECTED, np.int64),
        np.zeros(WAYS, np.int64), np.zeros(_GUESSES, np.int64), np.zeros((len(codes), 3), np.int32),
    )  # fmt: skip
    _code_all(coder, data, mixture, level, low, codes, vectors, units, scratch)


@loop
def _code_all(
    coder: Coder, data: NDArray[np.uint8], mixture: Mixture, level: OctreeLevel, low: Numbers, codes: Whole,
    vectors: Whole, units: Numbers, scratch: Scratch,
) -> None:  # fmt: skip
    """As `code_guided_planes`, with steps, normal unit and offset unit in `units`."""
    voxels, expected = level.voxels, scratch.expected
    for row in range(len(codes)):
        count, occupied = _look_around(level, row, scratch)
        far = range_class(voxels[row, 0] + low[0], voxels[row, 1] + low[1], voxels[row, 2] + low[2])
        _code_hits(coder, data, mixture, codes, scratch.near, count, occupied, far, voxels[row, 2] + low[2], row)
        expect_normal(scratch.around, occupied, row, voxels, low, scratch.spots, codes, units[0], expected)
        a, b = codes[row, 0], codes[row, 1]
        spread, turns = _code_normal(coder, data, mixture, codes, units, count, row, scratch)
        if a != codes[row, 0] or b != codes[row, 1]:
            codes[row, 2] = turned(codes[row, 2], vectors[a, b], vectors[codes[row, 0], codes[row, 1]])
        _code_offset(coder, data, mixture, voxels, codes, vectors, units[2], count, row, spread, turns, far, scratch)
        normal = vectors[codes[row, 0], codes[row, 1]]
        settle_spot(scratch.spots, row, normal, codes[row, 2] * units[2])


@inlined
def _look_around(level: OctreeLevel, row: int, scratch: Scratch) -> tuple[int, int]:
    """Fill `around` and `near` of the scratch; how many voxels before the row's are around it, and how many in all."""
    list_neighbours(level, row, scratch.around)
    count, occupied = 0, 0
    for k in range(NEIGHBOURS):
        other = scratch.around[k]
        scratch.around[occupied], scratch.near[count] = other, other
        occupied += 1 if other >= 0 else 0
        count += 1 if 0 <= other < row else 0
    return count, occupied


@inlined
def _code_hits(
    coder: Coder, data: NDArray[np.uint8], mixture: Mixture, codes: Whole, near: Whole, count: int, occupied: int,
    far: int, z: int, row: int,
) -> None:  # fmt: skip
    """The class of hits, guessed from those of neighbours and from the place: one bit for each class below it."""
    a, b, c, mean = nearest_hits(codes, near, count)
    height = min(max(z, -HEIGHTS // 2), HEIGHTS // 2 - 1) + HEIGHTS // 2
    few, at = min(count, _FEW - 1), mixture.at
    at[0] = _HITS[0] + ((a * HIT_CLASSES + b) * HIT_CLASSES + c) * HIT_CLASSES
    at[1] = _HITS[1] + (few * 32 + mean) * HIT_CLASSES
    at[2] = _HITS[2] + (far * 27 + occupied) * HIT_CLASSES
    at[3] = _HITS[3] + (far * 32 + mean) * HIT_CLASSES
    at[4] = _HITS[4] + (height * RANGES + far) * HIT_CLASSES
    value, which = 0, _HIT_SETS + few * HIT_CLASSES
    while value < HIT_CLASSES - 1:
        if mixed_bit(coder, data, mixture, value, which + value, 1 if codes[row, 3] == value else 0):
            break
        value += 1
    codes[row, 3] = value


@inlined
def _code_normal(
    coder: Coder, data: NDArray[np.uint8], mixture: Mixture, codes: Whole, units: Numbers, count: int, row: int,
    scratch: Scratch,
) -> tuple[int, int]:  # fmt: skip
    """Code the normal; returns how far the neighbours' normals spread, and by how much it is turned from theirs."""
    steps, unit, near = units[0], units[1], scratch.near
    expected, base, guesses = scratch.expected, scratch.base, scratch.guesses
    a, b = _on_grid(expected[NORMAL_A], steps, unit), _on_grid(expected[NORMAL_B], steps, unit)
    c, d, spread = expected[VIEW_A], expected[VIEW_B], SPREADS - 1
    if count > 0:
        typical, spread = typical_normal(codes, near, count, steps)
        other = near[1] if near[0] == typical and count > 1 else near[0]
        a, b = codes[typical, 0], codes[typical, 1]
        c, d = codes[other, 0], codes[other, 1]
    occupied = min(expected[OCCUPIED], _OCCUPIED - 1)
    if occupied == 0 and unit > 1:
        unit *= LONE
    few = min(count, _FEW - 1)
    flat, seen = expected[FLATNESS] * _OCCUPIED + occupied, occupied * _FEW + few
    base[0] = _FIRST[0] + ((spread * _TURNS + clipped(c - a, 4)) * _TURNS + clipped(d - b, 4)) * SLOTS
    base[1] = _FIRST[1] + (spread * _SIDE + _coarse(a, steps)) * SLOTS
    base[2] = _FIRST[2] + facing(a, b, steps) * SLOTS
    base[3], guesses[0] = _FIRST[3] + flat * _BESIDE, expected[NORMAL_A]
    base[4], guesses[1] = _FIRST[4] + seen * _BESIDE, expected[VIEW_A]
    first = _code_number(coder, data, mixture, scratch, spread, a, unit, steps_of(codes[row, 0] - a, unit))
    codes[row, 0] = min(max(a + first * unit, 0), 2 * steps)
    turn, size, now = clipped(first, 2), min(abs(first), 2), codes[row, 0]
    base[0] = _SECOND[0] + (((spread * _TURNS + clipped(d - b, 4)) * 5 + turn) * 3 + clipped(c - a, 1)) * SLOTS
    base[1] = _SECOND[1] + ((spread * _SIDE + _coarse(b, steps)) * 5 + turn) * SLOTS
    base[2] = _SECOND[2] + facing(now, b, steps) * SLOTS
    base[3], guesses[0] = _SECOND[3] + (flat * 3 + _off(now, expected[NORMAL_A])) * _BESIDE, expected[NORMAL_B]
    base[4], guesses[1] = _SECOND[4] + (seen * 3 + _off(now, expected[VIEW_A])) * _BESIDE, expected[VIEW_B]
    which = SPREADS + spread * 3 + size
    second = _code_number(coder, data, mixture, scratch, which, b, unit, steps_of(codes[row, 1] - b, unit))
    codes[row, 1] = min(max(b + second * unit, 0), 2 * steps)
    return int(spread), int(min(abs(first) + abs(second), 3))


@inlined
def _code_offset(
    coder: Coder, data: NDArray[np.uint8], mixture: Mixture, voxels: Whole, codes: Whole, vectors: Whole, unit: int,
    count: int, row: int, spread: int, turns: int, far: int, scratch: Scratch,
) -> None:  # fmt: skip
    """Code the offset of a normal that spread and turned as `_code_normal` says."""
    expected, base, guesses = scratch.expected, scratch.base, scratch.guesses
    normal = vectors[codes[row, 0], codes[row, 1]]
    parts, agreed, _ = guessed_offset(voxels, scratch.near, codes, vectors, row, count, unit)
    guess = (parts + unit // 2) // unit
    rest = clipped(8 * (parts - guess * unit) // unit, 4)
    occupied = min(expected[OCCUPIED], _OCCUPIED - 1)
    middle = normal[0] * expected[MEAN] + normal[1] * expected[MEAN + 1] + normal[2] * expected[MEAN + 2]
    middle //= FIXED * expected[MEAN + 3]
    base[0] = _OFFSET[0] + ((agreed * SPREADS + spread) * 4 + turns) * SLOTS
    base[1] = _OFFSET[1] + clipped(guess, _LONGEST) * SLOTS
    base[2] = _OFFSET[2] + ((steepest(normal) * SPREADS + agreed) * _TURNS + rest) * SLOTS
    base[3] = _OFFSET[3] + (expected[FLATNESS] * _OCCUPIED + occupied) * _BESIDE
    guesses[0] = (middle + unit // 2) // unit
    base[4], guesses[1] = _OFFSET[4] + (far * HIT_CLASSES + codes[row, 3]) * _BESIDE, guess
    which = 4 * SPREADS + agreed
    codes[row, 2] = guess + _code_number(coder, data, mixture, scratch, which, guess, 1, codes[row, 2] - guess)


@inlined
def _code_number(
    coder: Coder, data: NDArray[np.uint8], mixture: Mixture, scratch: Scratch, which: int, centre: int, unit: int,
    value: int,
) -> int:  # fmt: skip
    """Write or read a whole number between -2^16 and 2^16 of steps of a `unit` from a `centre`, small ones short.

    Asked is whether it is 0, then its sign, then for each size whether that is it; `which` is one class of sets.
    """
    size, sign = 0, 1
    for slot in range(SLOTS - 1):
        if slot != 1:
            size = max(slot - 1, 0)
        _ask(mixture.at, scratch, slot, centre + (sign * size * unit if slot > 1 else 0), sign)
        asked = value < 0 if slot == 1 else abs(value) == size
        bit = mixed_bit(coder, data, mixture, 0, which * SLOTS + slot, 1 if asked else 0)
        if slot == 1:
            sign = -1 if bit else 1
        elif bit:
            return sign * size
    negative = 1 if sign < 0 else 0
    return code_large(
        coder, data, mixture.models, scratch.base[0] + SLOTS - 1, abs(value) - size - 1, size + 1, negative
    )


@inlined
def _ask(at: Numbers, scratch: Scratch, slot: int, asked: int, sign: int) -> None:
    """Say in `at` which models are asked: of the last ones those of the distance of the `asked` value from a guess."""
    for k in range(_OTHER):
        at[k] = scratch.base[k] + slot
    for k in range(_GUESSES):
        beyond = min(max(sign * (asked - scratch.guesses[k]), -_NEAR), _NEAR) + _NEAR
        at[_OTHER + k] = scratch.base[_OTHER + k] + min(slot, 4) * (2 * _NEAR + 1) + beyond


@inlined
def _on_grid(code: int, steps: int, unit: int) -> int:
    """The code nearest to one, whole units from that of a normal straight up: level ground is stored as level."""
    return min(max(steps + steps_of(code - steps, unit) * unit, 0), 2 * steps)


@inlined
def _coarse(code: int, steps: int) -> int:
    """One of _SIDE classes of a code."""
    return code * (_SIDE - 2) // (2 * steps)


@inlined
def _off(code: int, guess: int) -> int:
    """0, 1 or 2 for how far a code is from its guess."""
    return min(abs(code - guess), 5) // 2
