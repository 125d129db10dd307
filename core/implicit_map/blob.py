"""The stored form of a neural map: sections of numbers in a checked container."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.container import Container
from revisit.core.errors import DataLoss

CONTAINER = Container(b"RVNM\x01", "stored neural map", level=12, max_body_bytes=256_000_000)


def pack(header: dict[str, Any], sections: list[bytes]) -> bytes:
    """The blob of a JSON-able `header` and `sections`."""
    return CONTAINER.pack({**header, "sections": [len(one) for one in sections]}, b"".join(sections))


def unpack(blob: bytes) -> tuple[dict[str, Any], list[bytes]]:
    """Header and sections of a blob. Raises DataLoss for anything that `pack` did not write."""
    header, body = CONTAINER.unpack(blob)
    try:
        ends = [0, *itertools.accumulate(header["sections"])]
        return header, [body[a:b] for a, b in itertools.pairwise(ends)]
    except (TypeError, KeyError) as error:
        raise DataLoss("the stored neural map cannot be read") from error


def to_varint(values: NDArray[np.integer]) -> bytes:
    """Small signed numbers as bytes: zigzag, one byte below 255, else 255 and four more."""
    zigzag = ((values.astype(np.int64) << 1) ^ (values.astype(np.int64) >> 63)).astype(np.uint32)
    small = np.minimum(zigzag, 255).astype(np.uint8)
    large = zigzag[zigzag >= 255].astype("<u4")
    return small.tobytes() + large.tobytes()


def from_varint(data: bytes, count: int) -> NDArray[np.int64]:
    """The inverse of `to_varint` for `count` numbers."""
    values = np.frombuffer(data, np.uint8, count).astype(np.int64)
    values[values == 255] = np.frombuffer(data, "<u4", offset=count)
    return np.asarray((values >> 1) ^ -(values & 1))
