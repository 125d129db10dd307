"""A checksum of a row: 64 bits, of which the lower half is of one value alone, so that it can be checked alone.

No secret is in it: it tells a damaged row, not a forged one (backups are signed, the audit log is chained).
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
import structlog

Value = str | int | float | bytes | None
"""Types of the values in a column."""

_LENGTH_BEYOND = 1e-3
"""How far the length of a descriptor may be from 1: thousands of times the rounding error."""

_UPPER = ~0xFFFFFFFF
"""The bits of a checksum that are of all values but the one that can be checked alone."""

log = structlog.get_logger(__name__)


def row_checksum(alone: bytes | None, *values: Value) -> int:
    """CRC-32 of `values`, above that of the bytes that can be checked `alone`; a signed number of 64 bits.

    Of single changed bits, and of up to 32 in a row, a CRC misses none; of other changes one in 2^32.
    """
    others = ascii([(len(value), zlib.crc32(value)) if isinstance(value, bytes) else value for value in values])
    size = None if alone is None else len(alone)
    halves = struct.pack(">II", zlib.crc32(f"{size} {others}".encode()), zlib.crc32(alone or b""))
    return int.from_bytes(halves, "big", signed=True)


def carried_checksum(stored: Value, before: int, after: int, alone_kept: int) -> int:
    """The checksum of a row that was changed; that of a damaged one stays wrong, so that its damage stays known.

    `stored` beside the sums of its values `before` and `after`. The value that can be checked alone is sound again
    where it is another one now.
    """
    if not isinstance(stored, int):
        stored = ~before
    wrong = stored ^ before
    carried = (stored if wrong & _UPPER else after) & _UPPER
    return carried | ((stored if wrong & ~_UPPER and alone_kept else after) & ~_UPPER)


def counted_checksum(stored: Value, before: int, after: int, _alone_kept: int) -> int:
    """That of a row of counters that was raised. Raises ValueError where it is damaged."""
    if stored != before:
        log.error("counters_damaged")
        raise ValueError("a row of counters is damaged")
    return after


def sound_descriptor(number: int, descriptor: bytes | None, checksum: int | None) -> bytes | None:
    """The stored descriptor of a submap of this number; None for one that is damaged, which is logged."""
    if descriptor is None or is_sound(descriptor, checksum):
        return descriptor
    log.error("descriptor_damaged", submap_number=number)
    return None


def is_sound(descriptor: bytes, checksum: int | None) -> bool:
    """Whether a stored descriptor fits its checksum, if it has one, and is of length 1."""
    if checksum is not None and zlib.crc32(descriptor) != checksum & 0xFFFFFFFF:
        return False
    vector = np.frombuffer(descriptor, dtype="<f4") if len(descriptor) % 4 == 0 else np.zeros(0, np.float32)
    # A NaN compares as no length.
    return bool(abs(float(vector @ vector) - 1.0) <= _LENGTH_BEYOND)
