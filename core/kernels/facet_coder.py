"""Facets of voxels as a stream of bits: where in each voxel a point lies and how it faces, guessed from those coded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, inner, loop
from revisit.core.kernels.plane_guesses import most_typical
from revisit.core.kernels.range_coder import Coder, Models, code_bit
from revisit.core.kernels.voxel_families import VoxelFamilies, beside, coded_neighbours

NORMAL_CODES = 15
"""Octahedral codes of a normal, along either axis of the square."""
ACROSS = 4
"""Cells along an edge of a voxel, across the axis that a normal is nearest to."""
_SIDE = 16  # a code, or that there is none
_SLOPES = 5
_GUESSES = 17
_SPREADS = 8
_LEVELS = 64
_FIRST_NORMAL = 0
_SECOND_NORMAL = _FIRST_NORMAL + _SIDE * _SIDE * _SIDE
_FIRST_CELL = _SECOND_NORMAL + 3 * _SIDE * _SIDE * _SIDE
_SECOND_CELL = _FIRST_CELL + 3 * 16 * _SLOPES * ACROSS
_LEVEL = _SECOND_CELL + 3 * 16 * _SLOPES * ACROSS * ACROSS
FACET_MODELS = _LEVEL + _SPREADS * _GUESSES * 2 * _LEVELS

Whole = NDArray[np.int32]


@loop
def code_facets(
    coder: Coder, data: NDArray[np.uint8], models: Models, families: VoxelFamilies, codes: Whole,
    places: Whole, vectors: Whole, steepest: Whole, bits: int,
) -> None:  # fmt: skip
    """Write `codes` (n, 2) and `places` (n, 3), or read and fill them: octahedral normal; level along the axis that it
    is nearest to, one of 2^`bits`, at most _LEVELS; cells along the other two.

    `families` are those of the voxels, which are coded in their order. vectors[i, j] (3,) is the normal of codes i, j
    in parts of 1024, steepest[i, j] the axis that it is nearest to.
    """
    near, voxels = families.near, families.voxels
    for row in range(len(codes)):
        count = coded_neighbours(families, row)
        _code_normal(coder, data, models, codes, row, near, count)
        axis = steepest[codes[row, 0], codes[row, 1]]
        _code_cells(coder, data, models, beside(families), codes, places, vectors, row, axis)
        guess, spread = _guessed_level(voxels, codes, places, vectors, steepest, row, axis, 1 << bits, near, count)
        middle = 1 if (places[row, 1] | places[row, 2]) & 1 else 0  # vertices lie on planes, not between two
        first = _LEVEL + ((spread * _GUESSES + guess) * 2 + middle) * _LEVELS
        places[row, 0] = _code_choice(coder, data, models, first, bits, places[row, 0])


@loop
def spread_out(
    voxels: Whole, codes: Whole, places: Whole, normals: NDArray[np.float64], steepest: Whole, low: NDArray[np.int64],
    steps: int, corner: float, edge: float, points: NDArray[np.float32],
) -> None:  # fmt: skip
    """Fill `points` (2, n, 3) with where the facets lie, in metres, and their normals.

    `low` (3,) is voxel 0, `normals` those of all codes, one row behind the other; voxels of so many `steps` and of
    `edge` metres begin `corner` of an edge before the origin.
    """
    for row in range(len(voxels)):
        axis, taken = steepest[codes[row, 0], codes[row, 1]], 1
        for k in range(3):
            if k == axis:
                within = (places[row, 0] + 0.5) / steps
            else:
                within = (places[row, taken] + 0.5) / ACROSS
                taken += 1
            points[0, row, k] = (voxels[row, k] + low[k] + within - corner) * edge
            points[1, row, k] = normals[codes[row, 0] * NORMAL_CODES + codes[row, 1], k]


@inlined
def _code_choice(coder: Coder, data: NDArray[np.uint8], models: Models, first: int, bits: int, value: int) -> int:
    """Write or read a number of so many bits, each guessed from those before; its models begin at `first`."""
    node = 1
    for shift in range(bits - 1, -1, -1):
        node = 2 * node + code_bit(coder, data, models, first + node, value >> shift & 1)
    return node - (1 << bits)


@inner
def _code_normal(
    coder: Coder, data: NDArray[np.uint8], models: Models, codes: Whole, row: int, near: Whole, count: int
) -> None:
    """The normal, guessed from the most typical of the neighbours and from the nearest other one."""
    a, b, c, d = _SIDE - 1, _SIDE - 1, _SIDE - 1, _SIDE - 1
    if count > 0:
        typical = most_typical(codes, near, count)[0]
        other = near[1] if near[0] == typical and count > 1 else near[0]
        a, b, c, d = codes[typical, 0], codes[typical, 1], codes[other, 0], codes[other, 1]
    model = _FIRST_NORMAL + (c * _SIDE + a) * _SIDE
    first = min(_code_choice(coder, data, models, model, 4, codes[row, 0]), NORMAL_CODES - 1)
    model = _SECOND_NORMAL + ((d * _SIDE + b) * 3 + min(abs(first - a), 2)) * _SIDE
    codes[row, 0] = first
    codes[row, 1] = min(_code_choice(coder, data, models, model, 4, codes[row, 1]), NORMAL_CODES - 1)


@inner
def _code_cells(
    coder: Coder, data: NDArray[np.uint8], models: Models, around: int, codes: Whole, places: Whole,
    vectors: Whole, row: int, axis: int,
) -> None:  # fmt: skip
    """The two cells, guessed from which voxels beside are occupied and which way the plane is inclined."""
    u, v = 0 if axis != 0 else 1, 2 if axis != 2 else 1
    sides = (axis * 4 + _both_sides(around, u)) * 4 + _both_sides(around, v)
    normal = vectors[codes[row, 0], codes[row, 1]]
    model = _FIRST_CELL + (sides * _SLOPES + _slope(normal[axis], normal[u])) * ACROSS
    places[row, 1] = _code_choice(coder, data, models, model, 2, places[row, 1])
    model = _SECOND_CELL + ((sides * _SLOPES + _slope(normal[axis], normal[v])) * ACROSS + places[row, 1]) * ACROSS
    places[row, 2] = _code_choice(coder, data, models, model, 2, places[row, 2])


@inlined
def _both_sides(around: int, axis: int) -> int:
    """Whether the voxels before and behind one along `axis` are occupied, a bit each."""
    return (around >> axis & 1) + (2 if around >> (axis + 3) & 1 else 0)


@inlined
def _slope(up: int, aside: int) -> int:
    """A class of how far a normal leans aside, whichever way it faces."""
    leans = aside if up >= 0 else -aside
    return min(max((leans + 128) // 256 + 2, 0), _SLOPES - 1)


@inner
def _guessed_level(
    voxels: Whole, codes: Whole, places: Whole, vectors: Whole, steepest: Whole, row: int, axis: int, steps: int,
    near: Whole, count: int,
) -> tuple[int, int]:  # fmt: skip
    """Classes of the level that continues the neighbours' planes, and of how well these agree.

    Lengths in half steps.
    """
    u, v = 0 if axis != 0 else 1, 2 if axis != 2 else 1
    normal = vectors[codes[row, 0], codes[row, 1]]
    total, weights, first, last = 0, 0, 1 << 30, -(1 << 30)
    for k in range(count):
        other = near[k]
        theirs = vectors[codes[other, 0], codes[other, 1]]
        agreement = (normal[0] * theirs[0] + normal[1] * theirs[1] + normal[2] * theirs[2]) // 1024
        up = normal[axis] + theirs[axis]
        if agreement < 307 or abs(up) < 300:
            continue
        their_axis = steepest[codes[other, 0], codes[other, 1]]
        aside = (normal[u] + theirs[u]) * _apart(voxels, places, row, axis, other, their_axis, u, steps)
        aside += (normal[v] + theirs[v]) * _apart(voxels, places, row, axis, other, their_axis, v, steps)
        above = 2 * steps * (voxels[other, axis] - voxels[row, axis])
        level = above + _within(places, other, their_axis, axis, steps) - aside // up
        weight = 8 if agreement > 921 else 3 if agreement > 716 else 1
        total += weight * level
        weights += weight
        first, last = min(first, level), max(last, level)
    if weights == 0:
        return 0, _SPREADS - 1
    guess = min(max(total // (2 * weights), 0), steps - 1)
    return 1 + guess * (_GUESSES - 1) // steps, _agreement((last - first) * 16 // steps, last > first, weights)


@inlined
def _agreement(spread: int, several: bool, weights: int) -> int:
    """A class of how far guesses spread, in 32nds of an edge, or of how much a single one weighs."""
    if not several:
        return 0 if weights < 8 else 1
    return 6 if spread > 25 else 5 if spread > 12 else 4 if spread > 5 else 3 if spread > 2 else 2


@inlined
def _within(places: Whole, row: int, own_axis: int, axis: int, steps: int) -> int:
    """Where in its voxel a point lies along `axis`; `own_axis` is the one that its normal is nearest to."""
    if axis == own_axis:
        return int(2 * places[row, 0] + 1)
    second = axis == 2 or (axis == 1 and own_axis == 2)
    return int((2 * places[row, 2 if second else 1] + 1) * (steps // ACROSS))


@inlined
def _apart(
    voxels: Whole, places: Whole, row: int, axis: int, other: int, their_axis: int, along: int, steps: int
) -> int:
    """How far the point of `row` lies from that of `other` along an axis across its own."""
    between = 2 * steps * (voxels[row, along] - voxels[other, along])
    return int(between + _within(places, row, axis, along, steps) - _within(places, other, their_axis, along, steps))
