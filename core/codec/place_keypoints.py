"""The keypoints of a place as coded (docs/decisions/0287): a stream of bits, each guessed from keypoints nearby."""

from __future__ import annotations

import struct
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.learned_chances import learned_chances
from revisit.core.codec.plain_keypoints import PlainReader, plain_keypoints
from revisit.core.errors import DataLoss
from revisit.core.kernels.keypoint_models import ANGLE_BITS, HIGHEST, KEYPOINT_MODELS

Whole = NDArray[np.int64]
Coded = tuple[Whole, Whole, NDArray[np.bool_]]
"""Cells (n, 2) of 16 bits, angles (n,) of ANGLE_BITS, and descriptors (n, 2 l)."""

ANGLES = 1 << ANGLE_BITS
LEARNED = "place-keypoints-1.npz"
"""Where in core/weights the chances are with which the models begin."""

_HEAD = struct.Struct("<2hHB")  # lowest cell, distance of two cells, bits of an x
_MOST_WIDE = HIGHEST.bit_length()
_FIRST_ROOM, _BYTES_EACH = 256, 8  # twice what keypoints take as a rule


def write_keypoints(cells: Whole, angles: Whole, bits: NDArray[np.bool_]) -> bytes:
    """The keypoints as bytes, in the order of `in_stored_order`; of none, none."""
    return coded_keypoints(cells, angles, bits, begun()) if len(cells) else b""


def coded_keypoints(cells: Whole, angles: Whole, bits: NDArray[np.bool_], models: NDArray[np.int32]) -> bytes:
    """As `write_keypoints`, of one keypoint at least, with these models (KEYPOINT_MODELS, 2), which learn of them."""
    from revisit.core.kernels.keypoint_coder import code_keypoints  # the gateway reads without compiled code
    from revisit.core.kernels.range_coder import finish, start

    rows = in_stored_order(cells)
    low = cells.min(axis=0)
    step = max(int(np.gcd.reduce((cells - low).ravel())), 1)
    inside = ((cells[rows] - low) // step).astype(np.int32)
    wide, fresh = int(inside[:, 0].max()).bit_length(), models.copy()
    turned, flags = angles[rows].astype(np.int32), bits[rows].astype(np.uint8)
    room = _FIRST_ROOM + _BYTES_EACH * len(cells)
    while True:
        data, models[:] = np.zeros(room, dtype=np.uint8), fresh
        coder = start(data, False)
        code_keypoints(coder, data, models, inside, turned, flags, wide)
        room = finish(coder, data)
        if room <= len(data):
            return _HEAD.pack(*low, step, wide) + data[:room].tobytes()


def read_keypoints(data: bytes, count: int, numbers: int, *, compiled: bool = True) -> Coded:
    """The inverse of `write_keypoints`, of descriptors of so many numbers. Raises DataLoss for anything else.

    Not `compiled` it takes some 10 ms, and no library but NumPy.
    """
    if count == 0:
        if data:
            raise DataLoss("the place holds more keypoints than it says")
        return np.zeros((0, 2), np.int64), np.zeros(0, np.int64), np.zeros((0, 2 * numbers), dtype=bool)
    if len(data) < _HEAD.size:
        raise DataLoss("the keypoints of the place are cut short")
    *low, step, wide = _HEAD.unpack_from(data)
    if wide > _MOST_WIDE:
        raise DataLoss("the keypoints of the place are unusable")
    read = _compiled if compiled else _plain
    inside, angles, bits, position = read(data[_HEAD.size :], count, numbers, wide)
    if len(inside) != count or position != len(data) - _HEAD.size:
        raise DataLoss("the keypoints of the place do not hold what it says")
    cells = inside * step + np.array(low, dtype=np.int64)
    if np.abs(cells).max(initial=0) > 32768:
        raise DataLoss("the keypoints of the place are unusable")
    return cells, angles, bits > 0


def in_stored_order(cells: Whole) -> Whole:
    """The rows (n,) of cells (n, 2) as they are written: by y, then x."""
    return np.asarray(np.lexsort((cells[:, 0], cells[:, 1])))


def begun() -> NDArray[np.int32]:
    """The models (KEYPOINT_MODELS, 2) with which a stream begins."""
    return _learned().copy()


def _compiled(data: bytes, count: int, numbers: int, wide: int) -> tuple[Whole, Whole, NDArray[np.uint8], int]:
    from revisit.core.kernels.keypoint_coder import code_keypoints
    from revisit.core.kernels.range_coder import position, start

    stream = np.frombuffer(data, np.uint8).copy()  # the compiled coder could also write
    coder = start(stream, True)
    cells, angles = np.zeros((count, 2), np.int32), np.zeros(count, np.int32)
    bits = np.zeros((count, 2 * numbers), np.uint8)
    code_keypoints(coder, stream, begun(), cells, angles, bits, wide)
    return cells.astype(np.int64), angles.astype(np.int64), bits, position(coder)


def _plain(data: bytes, count: int, numbers: int, wide: int) -> tuple[Whole, Whole, NDArray[np.uint8], int]:
    chances, seen = begun().T.tolist()
    reader = PlainReader(data, chances, seen)
    read = list(plain_keypoints(reader, len(data), count, numbers, wide))
    columns = np.array([(x, y, angle) for x, y, angle, _ in read], dtype=np.int64).reshape(-1, 3)
    bits = np.array([bits for *_, bits in read], dtype=np.uint8).reshape(-1, 2 * numbers)
    return columns[:, :2], columns[:, 2], bits, reader.position


@lru_cache(maxsize=1)
def _learned() -> NDArray[np.int32]:
    """The learned models."""
    models = learned_chances(LEARNED)
    if models.shape != (KEYPOINT_MODELS, 2):
        raise DataLoss(f"{LEARNED} does not fit this version")
    return models
