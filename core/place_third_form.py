"""The third stored form of a place, which is still read."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.container import Container
from revisit.core.errors import DataLoss
from revisit.core.place_form import (
    DIMENSIONS,
    MAX_ROWS,
    PlaceContents,
    bounded,
    keypoints_of,
    spacing_of,
    surface_read,
)

Bits = NDArray[np.uint8]
Whole = NDArray[np.int64]

CONTAINER = Container(b"RVPS\x03", "stored place", level=9, max_body_bytes=4_000_000, digest_bytes=16, body_length=True)
FRAME_BYTES = 12 * 8
"""The body begins with the similarity from submap to level frame (3, 4), float64."""

_ANGLE_BITS = 8
_HEAD = struct.Struct("<2h2H")  # lowest cell, distance of two cells, bits of a column
_PLAIN = 7  # a column as it is, its ones not by their gaps
_COLUMN_BITS = 4  # whether a column is turned round, and how its gaps are written
_COUNT_BITS = 24
_WIDTHS = range(_PLAIN)


def read_third_form(header: dict[str, Any], body: bytes, *, surface: bool) -> PlaceContents:
    """The arrays of a blob of the third form; without `surface` its points are left out. Raises DataLoss."""
    count, size = bounded(header, "keypoints", MAX_ROWS), bounded(header, "size", DIMENSIONS)
    parity, keypoints, standing, ground = _sections(header, body)
    if len(parity) != (size + 7) // 8:
        raise DataLoss("the place's sections do not have the announced sizes")
    signs = np.unpackbits(np.frombuffer(parity, np.uint8), count=size)
    cells, angles, bits = _keypoints_read(keypoints, count, 2 * size)
    points, normals, standing_count = surface_read((standing, ground) if surface else (b"", b""), spacing_of(header))
    signed = 2.0 * signs.astype(np.float32) - 1.0
    return PlaceContents(*keypoints_of(cells, angles, bits), signed, points, normals, standing_count)


def _sections(header: dict[str, Any], body: bytes) -> list[bytes]:
    """The four parts of the body."""
    sizes = header.get("sections")
    if not isinstance(sizes, list) or len(sizes) != 4 or not all(type(n) is int and 0 <= n <= len(body) for n in sizes):
        raise DataLoss("the place's sections are unusable")
    ends = np.cumsum(sizes)
    if len(body) != ends[-1]:
        raise DataLoss("the place's sections do not have the announced sizes")
    return [body[end - size : end] for end, size in zip(ends, sizes, strict=True)]


def _keypoints_read(data: bytes, count: int, columns: int) -> tuple[Whole, Whole, NDArray[np.bool_]]:
    """Cells (n, 2), angles (n,) and bits of descriptors (n, d). Raises DataLoss for anything else."""
    if len(data) < _HEAD.size:
        raise DataLoss("the keypoints of the place are cut short")
    *low, step, wide = _HEAD.unpack_from(data)
    if wide > 16:
        raise DataLoss("the keypoints of the place are unusable")
    string = _String(np.unpackbits(np.frombuffer(data, np.uint8, offset=_HEAD.size)))
    y = np.cumsum(string.unary(count))
    x = string.fixed(count, wide)
    angles = string.fixed(count, _ANGLE_BITS)
    bits = _columns_read(string, count, columns)
    string.finish()
    cells = np.stack([x, y], axis=1) * step + np.array(low, dtype=np.int64)
    if count and np.abs(cells).max() > 32768:
        raise DataLoss("the keypoints of the place are unusable")
    return cells, angles, bits


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


def _between(gaps: Whole, length: int) -> NDArray[np.bool_]:
    """So many flags, of which each one has a number of zeros before it."""
    flags = np.zeros(length, dtype=bool)
    ones = np.cumsum(gaps + 1) - 1
    if len(ones) and ones[-1] >= length:
        raise DataLoss("the keypoints of the place are unusable")
    flags[ones] = True
    return flags


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
        """Numbers (n,) of `width` bits each, the highest first."""
        bits = self.take(count * width).reshape(count, width)
        return np.asarray(bits @ (1 << np.arange(width, dtype=np.int64)[::-1]))

    def unary(self, count: int) -> Whole:
        """Numbers (n,), each as that many zeros and a one."""
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
