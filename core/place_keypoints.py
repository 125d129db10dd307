"""The keypoints of a place as a string of bits (docs/decisions/0217), in NumPy alone: the gateway reads them too."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import DataLoss

Bits = NDArray[np.uint8]
Whole = NDArray[np.int64]

ANGLE_BITS = 8

_HEAD = struct.Struct("<2h2H")  # lowest cell, distance of two cells, bits of a column
_PLAIN = 7  # a column as it is, its ones not by their gaps
_COLUMN_BITS = 4  # whether a column is turned round, and how its gaps are written
_COUNT_BITS = 24
_WIDTHS = range(_PLAIN)


def write_keypoints(cells: Whole, angles: Whole, bits: NDArray[np.bool_]) -> bytes:
    """Cells (n, 2) of 16 bits, angles (n,) of ANGLE_BITS and descriptors (n, d), sorted by cell: y, then x.

    A y is written as the zeros between it and the one before. Of the descriptors each column is written whole; one with
    few ones as the gaps between them, all columns of the same width one behind the other (Golomb and Rice).
    """
    rows = in_stored_order(cells)
    cells, angles, bits = cells[rows], angles[rows], bits[rows]
    low = cells.min(axis=0, initial=32767)
    step = max(int(np.gcd.reduce((cells - low).ravel(), initial=0)), 1)
    x, y = ((cells - low) // step).T
    wide = int(x.max(initial=0)).bit_length()
    strings = [_unary(np.diff(y, prepend=0)), _fixed(x, wide), _fixed(angles, ANGLE_BITS), *_columns(bits)]
    return _HEAD.pack(*low, step, wide) + np.packbits(np.concatenate(strings)).tobytes()


def in_stored_order(cells: Whole) -> Whole:
    """The rows (n,) of cells (n, 2) as they are written: by y, then x."""
    return np.asarray(np.lexsort((cells[:, 0], cells[:, 1])))


def read_keypoints(data: bytes, count: int, columns: int) -> tuple[Whole, Whole, NDArray[np.bool_]]:
    """The inverse of `write_keypoints`. Raises DataLoss for anything else."""
    if len(data) < _HEAD.size:
        raise DataLoss("the keypoints of the place are cut short")
    *low, step, wide = _HEAD.unpack_from(data)
    if wide > 16:
        raise DataLoss("the keypoints of the place are unusable")
    string = _String(np.unpackbits(np.frombuffer(data, np.uint8, offset=_HEAD.size)))
    y = np.cumsum(string.unary(count))
    x = string.fixed(count, wide)
    angles = string.fixed(count, ANGLE_BITS)
    bits = _columns_read(string, count, columns)
    string.finish()
    cells = np.stack([x, y], axis=1) * step + np.array(low, dtype=np.int64)
    if count and np.abs(cells).max() > 32768:
        raise DataLoss("the keypoints of the place are unusable")
    return cells, angles, bits


def _columns(bits: NDArray[np.bool_]) -> Iterator[Bits]:
    count = len(bits)
    turned = 2 * bits.sum(axis=0) > count
    rare = (bits ^ turned).T
    widths = _best_widths(rare.sum(axis=1), count)
    yield _fixed(8 * turned + widths, _COLUMN_BITS)
    yield rare[widths == _PLAIN].ravel().astype(np.uint8)
    for width in _WIDTHS:
        if (widths == width).any():
            gaps = _gaps(rare[widths == width].ravel())
            yield _fixed(np.array([len(gaps)]), _COUNT_BITS)
            yield _unary(gaps >> width)
            yield _fixed(gaps & ((1 << width) - 1), width)


def _columns_read(string: _String, count: int, columns: int) -> NDArray[np.bool_]:
    turned, widths = np.divmod(string.fixed(columns, _COLUMN_BITS), 8)
    rare = np.zeros((columns, count), dtype=bool)
    plain = widths == _PLAIN
    rare[plain] = string.take(int(plain.sum()) * count).reshape(-1, count)
    for width in _WIDTHS:
        chosen = widths == width
        if chosen.any():
            found = int(string.fixed(1, _COUNT_BITS)[0])
            gaps = (string.unary(found) << width) + string.fixed(found, width)
            rare[chosen] = _between(gaps, int(chosen.sum()) * count).reshape(-1, count)
    return np.ascontiguousarray((rare ^ (turned == 1)[:, None]).T)


def _best_widths(ones: Whole, count: int) -> Whole:
    """How many low bits of its gaps are written as they are, by how many of `count` flags of a column are ones; _PLAIN
    where the flags themselves are no longer.
    """
    gap = (count - ones) / np.maximum(ones, 1)
    widths = np.clip(np.rint(np.log2(np.maximum(np.log(2.0) * gap, 1.0))), 0, _PLAIN - 1).astype(np.int64)
    coded = ones * (gap / (1 << widths) + 1 + widths)
    return np.where((coded < count) | (ones == 0), widths, _PLAIN)


def _gaps(flags: NDArray[np.bool_]) -> Whole:
    """How many zeros stand before each one of the flags."""
    return np.asarray(np.diff(np.flatnonzero(flags), prepend=-1) - 1)


def _between(gaps: Whole, length: int) -> NDArray[np.bool_]:
    """The inverse of `_gaps`, of so many flags."""
    flags = np.zeros(length, dtype=bool)
    ones = np.cumsum(gaps + 1) - 1
    if len(ones) and ones[-1] >= length:
        raise DataLoss("the keypoints of the place are unusable")
    flags[ones] = True
    return flags


def _fixed(numbers: Whole, width: int) -> Bits:
    """Numbers (n,) of `width` bits each, the highest first."""
    return np.asarray((numbers[:, None] >> np.arange(width)[::-1]) & 1, dtype=np.uint8).ravel()


def _unary(numbers: Whole) -> Bits:
    """Each number as that many zeros and a one."""
    ends = np.cumsum(numbers + 1)
    string = np.zeros(int(ends[-1]) if len(ends) else 0, dtype=np.uint8)
    string[ends - 1] = 1
    return string


class _String:
    """A string of bits that is read from its beginning on. All raise DataLoss behind its end."""

    def __init__(self, bits: Bits) -> None:
        self._bits, self._at, self._ones = bits, 0, np.flatnonzero(bits)

    def take(self, length: int) -> Bits:
        """The next bits."""
        taken = self._bits[self._at : self._at + length]
        if len(taken) != length:
            raise DataLoss("the keypoints of the place are cut short")
        self._at += length
        return taken

    def fixed(self, count: int, width: int) -> Whole:
        """The inverse of `_fixed`."""
        bits = self.take(count * width).reshape(count, width)
        return np.asarray(bits @ (1 << np.arange(width, dtype=np.int64)[::-1]))

    def unary(self, count: int) -> Whole:
        """The inverse of `_unary`."""
        first = int(np.searchsorted(self._ones, self._at))
        ends = self._ones[first : first + count]
        if len(ends) != count:
            raise DataLoss("the keypoints of the place are cut short")
        numbers = np.diff(ends, prepend=self._at - 1) - 1
        self._at = int(ends[-1]) + 1 if count else self._at
        return np.asarray(numbers)

    def finish(self) -> None:
        """Raises DataLoss where more than the zeros that fill the last byte are left."""
        left = self._bits[self._at :]
        if len(left) > 7 or left.any():
            raise DataLoss("the keypoints of the place are too long")
