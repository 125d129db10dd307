"""A binary arithmetic coder with adaptive models: the same calls write and read, so that the two cannot disagree.

All arithmetic is on integers: every machine reads the stream of every other one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, inner, loop

Coder = NDArray[np.int64]
"""Lower and upper end of the interval, the bytes read ahead, the position in the data, and 1 where it reads."""
Models = NDArray[np.int32]
"""Adaptive models (n, 2): the chance of a one out of 2^16, and how many bits each has seen."""

_TOP = 0xFFFFFFFF
_EVEN = 1 << 15
_CERTAIN = 1 << 16
_MOST_SEEN = 250
_SHIFT = 40
_SHARES = np.array([-(-(1 << _SHIFT) // (2 * seen + 3)) for seen in range(_MOST_SEEN + 1)])
"""1 / (2 seen + 3), rounded up: of numbers below 2^18 the products are right to the last bit."""
UNARY = 14
"""Models of one class of whole numbers: one for zero, one for the sign, twelve for the size."""

_LOW, _HIGH, _CODE, _AT, _READS = 0, 1, 2, 3, 4


def fresh_models(count: int) -> Models:
    """So many models that have seen nothing."""
    models = np.zeros((count, 2), dtype=np.int32)
    models[:, 0] = _EVEN
    return models


def start(data: NDArray[np.uint8], reads: bool) -> Coder:
    """A coder at the beginning of `data` (n,), which it reads, or else writes."""
    coder = np.zeros(5, dtype=np.int64)
    coder[_HIGH] = _TOP
    coder[_READS] = 1 if reads else 0
    if reads:
        for _ in range(4):
            _next_byte(coder, data)
    return coder


@loop
def finish(coder: Coder, data: NDArray[np.uint8]) -> int:
    """Write the rest of the interval; returns how many bytes of `data` are used, or would have been."""
    if coder[_READS] == 0:
        value = coder[_LOW] + (1 << 23)
        if value > coder[_HIGH]:
            value = coder[_HIGH]
        for shift in (24, 16, 8, 0):
            _put(coder, data, (value >> shift) & 0xFF)
    return int(coder[_AT])


def position(coder: Coder) -> int:
    """How many bytes are written or read: after the last bit of `finish`, the exact number."""
    return int(coder[_AT])


@inner
def _put(coder: Coder, data: NDArray[np.uint8], byte: int) -> None:
    """Write a byte; behind the end it is only counted."""
    if coder[_AT] < len(data):
        data[coder[_AT]] = byte
    coder[_AT] += 1


@inner
def _next_byte(coder: Coder, data: NDArray[np.uint8]) -> None:
    """Read a byte; behind the end there are zeros."""
    byte = np.int64(data[coder[_AT]]) if coder[_AT] < len(data) else np.int64(0)
    coder[_CODE] = ((coder[_CODE] << 8) | byte) & _TOP
    coder[_AT] += 1


@inlined
def past_end(coder: Coder, data: NDArray[np.uint8]) -> bool:
    """Whether it reads and has read more than `data` holds: then it is damaged."""
    return bool(coder[_READS] == 1 and coder[_AT] > len(data))


@inlined
def code_bit(coder: Coder, data: NDArray[np.uint8], models: Models, model: int, bit: int) -> int:
    """Write `bit` with the chance that models[model] gives it, or read and return the bit; the model learns of it."""
    bit = narrow(coder, data, models[model, 0], bit)
    learn(models, model, bit)
    return bit


@inlined
def narrow(coder: Coder, data: NDArray[np.uint8], chance: int, bit: int) -> int:
    """Write `bit`, which is a one with a `chance` out of 2^16, or read and return it."""
    middle = coder[_LOW] + (((coder[_HIGH] - coder[_LOW]) * np.int64(chance)) >> 16)
    if coder[_READS] == 1:
        bit = 1 if coder[_CODE] <= middle else 0
    if bit:
        coder[_HIGH] = middle
    else:
        coder[_LOW] = middle + 1
    while ((coder[_LOW] ^ coder[_HIGH]) & 0xFF000000) == 0:
        if coder[_READS] == 1:
            _next_byte(coder, data)
        else:
            _put(coder, data, coder[_HIGH] >> 24)
        coder[_LOW] = (coder[_LOW] << 8) & _TOP
        coder[_HIGH] = ((coder[_HIGH] << 8) & _TOP) | 0xFF
    return bit


@inlined
def learn(models: Models, model: int, bit: int) -> None:
    """Move the chance of models[model] towards a bit."""
    chance, seen = np.int64(models[model, 0]), np.int64(models[model, 1])
    # 2 / (2 seen + 3) of the way to the bit, rounded down: by a product and a shift, faster than a division
    if bit:
        chance += (2 * (_CERTAIN - chance) * _SHARES[seen]) >> _SHIFT
    else:
        chance -= ((2 * chance + 2 * seen + 2) * _SHARES[seen]) >> _SHIFT
    models[model, 0] = min(max(chance, 64), _CERTAIN - 64)
    if seen < _MOST_SEEN:
        models[model, 1] = seen + 1


@inner
def code_number(coder: Coder, data: NDArray[np.uint8], models: Models, first: int, value: int) -> int:
    """Write or read a whole number between -2^16 and 2^16, small ones short; its UNARY models begin at `first`."""
    if code_bit(coder, data, models, first, 1 if value == 0 else 0):
        return 0
    negative = code_bit(coder, data, models, first + 1, 1 if value < 0 else 0)
    size, rest = 1, abs(value)
    while size < UNARY - 2:
        if code_bit(coder, data, models, first + 1 + size, 1 if rest == size else 0):
            return -size if negative else size
        size += 1
    return code_large(coder, data, models, first + 1 + size, rest - size, size, negative)


@inner
def code_large(
    coder: Coder, data: NDArray[np.uint8], models: Models, model: int, rest: int, size: int, negative: int
) -> int:
    """The part of a large number above `size`: sixteen bits with one model."""
    found = 0
    for shift in range(16, -1, -1):
        found |= code_bit(coder, data, models, model, (rest >> shift) & 1) << shift
    return -(size + found) if negative else size + found
