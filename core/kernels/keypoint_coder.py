"""Keypoints as a stream of bits: where they lie, how they are turned, and their descriptors, guessed from those nearby.

Patches of two keypoints a few metres apart, turned alike, show much the same. `codec.plain_keypoints` reads the same
stream without compiled code.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.keypoint_models import (
    ANGLE,
    ANGLE_BITS,
    APART,
    ASIDE,
    FAR,
    HIGHEST,
    LONGEST_STEP,
    OTHER,
    SAME,
    SIGN,
    SIZE,
    TREE,
    UP,
    WINDOW,
)
from revisit.core.kernels.loops import inner, loop
from revisit.core.kernels.range_coder import Coder, Models, code_bit, past_end

Whole = NDArray[np.int32]
Bits = NDArray[np.uint8]


@loop
def code_keypoints(
    coder: Coder, data: NDArray[np.uint8], models: Models, cells: Whole, angles: Whole, bits: Bits, wide: int
) -> None:
    """Write cells (n, 2), `angles` (n,) and `bits` (n, 2 l), or read and fill them.

    Cells are sorted by y, then x, from 0 up to HIGHEST; an x has `wide` bits. Of each number of a descriptor two bits
    are kept: its sign, and whether it is large. A damaged stream gives others; behind its end nothing is read.
    """
    for row in range(len(cells)):
        if past_end(coder, data):
            return
        _code_cell(coder, data, models, cells, row, wide)
        first, second, apart = _nearest(cells, angles, row, 0)
        _code_angle(coder, data, models, angles, row, first, second, apart)
        first, second, apart = _nearest(cells, angles, row, 1)
        _code_descriptor(coder, data, models, bits, row, first, second, apart)


@inner
def _code_cell(coder: Coder, data: NDArray[np.uint8], models: Models, cells: Whole, row: int, wide: int) -> None:
    """The y as steps from the one before, then the x."""
    y, step = cells[row - 1, 1] if row else 0, 0
    while y < HIGHEST and not code_bit(
        coder, data, models, UP + min(step, LONGEST_STEP), 1 if cells[row, 1] == y else 0
    ):
        y += 1
        step += 1
    node, x = 1, cells[row, 0]
    for shift in range(wide - 1, -1, -1):
        model = ASIDE + (node if node < TREE else TREE + shift)
        node = 2 * node + code_bit(coder, data, models, model, x >> shift & 1)
    cells[row, 0], cells[row, 1] = node - (1 << wide), y


@inner
def _nearest(cells: Whole, angles: Whole, row: int, turns: int) -> tuple[int, int, int]:
    """The nearest two of the keypoints before, and a class of how near the first is; of one alone it is both, of none
    -1.

    A squared distance in cells; with `turns` 1 the squared difference of the angles is added.
    """
    first, second, least, less = -1, -1, 1 << 40, 1 << 40
    for other in range(max(0, row - WINDOW), row):
        x, y = int(cells[row, 0] - cells[other, 0]), int(cells[row, 1] - cells[other, 1])
        turn = 0
        if turns:
            half = 1 << (ANGLE_BITS - 1)
            turn = int((angles[row] - angles[other] + half) % (2 * half) - half)
        apart = x * x + y * y + turn * turn
        if apart < least:
            first, second, least, less = other, first, apart, least
        elif apart < less:
            second, less = other, apart
    size = 0
    while size < FAR and least > APART[size]:
        size += 1
    return first, first if second < 0 else second, size


@inner
def _code_angle(
    coder: Coder, data: NDArray[np.uint8], models: Models, angles: Whole, row: int, first: int, second: int, apart: int
) -> None:
    """That of the nearest keypoint, or of the second, or another one."""
    if first >= 0:
        alike = 1 if angles[first] == angles[second] else 0
        if code_bit(coder, data, models, SAME + 2 * apart + alike, 1 if angles[row] == angles[first] else 0):
            angles[row] = angles[first]
            return
        if not alike and code_bit(coder, data, models, OTHER + apart, 1 if angles[row] == angles[second] else 0):
            angles[row] = angles[second]
            return
    node = 1
    for shift in range(ANGLE_BITS - 1, -1, -1):
        node = 2 * node + code_bit(coder, data, models, ANGLE + node, angles[row] >> shift & 1)
    angles[row] = node - (1 << ANGLE_BITS)


@inner
def _code_descriptor(
    coder: Coder, data: NDArray[np.uint8], models: Models, bits: Bits, row: int, first: int, second: int, apart: int
) -> None:
    """Of each number whether it is large, and whether its sign is that of the nearest keypoint's."""
    for k in range(bits.shape[1] // 2):
        sign, large, other_sign, other_large = 0, 0, 0, 0
        if first >= 0:
            sign, large = int(bits[first, 2 * k]), int(bits[first, 2 * k + 1])
            other_sign, other_large = int(bits[second, 2 * k]), int(bits[second, 2 * k + 1])
        around = 2 * (k * (FAR + 1) + apart) + large
        own = code_bit(coder, data, models, SIZE + 2 * around + other_large, bits[row, 2 * k + 1])
        model = SIGN + 8 * around + 4 * own + 2 * (1 if sign == other_sign else 0) + other_large
        turned = code_bit(coder, data, models, model, bits[row, 2 * k] ^ sign)
        bits[row, 2 * k], bits[row, 2 * k + 1] = turned ^ sign, own
