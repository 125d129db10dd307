"""Coded keypoints read without compiled code: the plain formula of `core.kernels.keypoint_coder`."""

from __future__ import annotations

from collections.abc import Iterator

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

Keypoint = tuple[int, int, int, list[int]]
"""Its cell x, y, its angle, and the bits of its descriptor."""

_EVERY = 1 << 32
_MOST_SEEN = 250
_CERTAIN = 1 << 16
_LEAST = 64


class PlainReader:
    """A stream of bits, each read with the chance that its model gives it; the models learn of them.

    `chances` are those of a one out of 2^16, `seen` how many bits each model has seen; both change. Arithmetic is that
    of `core.kernels.range_coder`.
    """

    def __init__(self, data: bytes, chances: list[int], seen: list[int]) -> None:
        self._data, self._chances, self._seen, self.position = data, chances, seen, 4
        self._low, self._high = 0, _EVERY - 1
        self._code = int.from_bytes(data[:4].ljust(4, b"\0"), "big")

    def bit(self, model: int) -> int:
        """The next bit."""
        chance, seen = self._chances[model], self._seen[model]
        middle = self._low + ((self._high - self._low) * chance >> 16)
        bit = 1 if self._code <= middle else 0
        if bit:
            self._high = middle
            chance += 2 * (_CERTAIN - chance) // (2 * seen + 3)
        else:
            self._low = middle + 1
            chance -= -(-2 * chance // (2 * seen + 3))
        # not by min and max: of 13,000 bits their calls would be a third of the time
        if not _LEAST <= chance <= _CERTAIN - _LEAST:
            chance = _LEAST if chance < _LEAST else _CERTAIN - _LEAST
        self._chances[model] = chance
        if seen < _MOST_SEEN:
            self._seen[model] = seen + 1
        while (self._low ^ self._high) < 1 << 24:
            self._next_byte()
        return bit

    def _next_byte(self) -> None:
        following = self._data[self.position] if self.position < len(self._data) else 0
        self._code = (self._code << 8 | following) % _EVERY
        self._low = (self._low << 8) % _EVERY
        self._high = (self._high << 8) % _EVERY | 0xFF
        self.position += 1

    def number(self, bits: int, first: int, tree: int, rest: int) -> int:
        """A number of so many bits, the highest first: models `first` on for those whose number of bits before is below
        `tree`, for the others one each from `rest` on.
        """
        node = 1
        for shift in range(bits - 1, -1, -1):
            node = 2 * node + self.bit(first + node if node < tree else rest + shift)
        return node - (1 << bits)


def plain_keypoints(reader: PlainReader, length: int, count: int, numbers: int, wide: int) -> Iterator[Keypoint]:
    """The keypoints of a stream of `length` bytes, as `code_keypoints` reads them: `count`, fewer behind its end."""
    before: list[Keypoint] = []
    for row in range(count):
        if reader.position > length:
            return
        x, y = _cell(reader, before[-1][1] if row else 0, wide)
        apart = _apart(before, x, y)
        angle = _angle(reader, *_nearest(before, apart))
        apart = [a + b for a, b in zip(apart, _turned(before, angle), strict=True)]
        bits = _descriptor(reader, *_nearest(before, apart), numbers)
        before = [*before[1 - WINDOW :], (x, y, angle, bits)]
        yield before[-1]


def _cell(reader: PlainReader, y: int, wide: int) -> tuple[int, int]:
    step = 0
    while y < HIGHEST and not reader.bit(UP + min(step, LONGEST_STEP)):
        y, step = y + 1, step + 1
    return reader.number(wide, ASIDE, TREE, ASIDE + TREE), y


def _apart(before: list[Keypoint], x: int, y: int) -> list[int]:
    """The squared distances from a cell to those of the keypoints."""
    return [(x - other[0]) ** 2 + (y - other[1]) ** 2 for other in before]


def _turned(before: list[Keypoint], angle: int) -> list[int]:
    """The squared differences from an angle to those of the keypoints."""
    half = 1 << (ANGLE_BITS - 1)
    return [((angle - other[2] + half) % (2 * half) - half) ** 2 for other in before]


def _nearest(before: list[Keypoint], apart: list[int]) -> tuple[Keypoint | None, Keypoint | None, int]:
    """The nearest two of the keypoints, which are so far `apart`, and a class of how near the first is."""
    if not before:
        return None, None, FAR
    least = min(apart)
    first = apart.index(least)
    rest = apart[:first] + apart[first + 1 :]
    second = rest.index(min(rest)) if rest else first
    other = before[second + 1 if rest and second >= first else second]
    return before[first], other, sum(least > limit for limit in APART)


def _angle(reader: PlainReader, first: Keypoint | None, second: Keypoint | None, apart: int) -> int:
    if first is not None and second is not None:
        alike = first[2] == second[2]
        if reader.bit(SAME + 2 * apart + alike):
            return first[2]
        if not alike and reader.bit(OTHER + apart):
            return second[2]
    return reader.number(ANGLE_BITS, ANGLE, 1 << ANGLE_BITS, 0)


def _descriptor(
    reader: PlainReader, first: Keypoint | None, second: Keypoint | None, apart: int, numbers: int
) -> list[int]:
    own: list[int] = []
    near, other = (one[3] if one is not None else [0] * (2 * numbers) for one in (first, second))
    for k in range(numbers):
        sign, large = near[2 * k], near[2 * k + 1]
        around = 2 * (k * (FAR + 1) + apart) + large
        size = reader.bit(SIZE + 2 * around + other[2 * k + 1])
        model = SIGN + 8 * around + 4 * size + 2 * (sign == other[2 * k]) + other[2 * k + 1]
        own += [reader.bit(model) ^ sign, size]
    return own
