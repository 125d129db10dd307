"""The stored form of a neural map: sections of bytes in a checked container, and of the forms before it."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.container import Container
from revisit.core.errors import DataLoss

CONTAINER = Container(b"RVNM\x03", "stored neural map", level=12, max_body_bytes=256_000_000)
SECOND_CONTAINER = Container(b"RVNM\x02", "stored neural map", level=12, max_body_bytes=256_000_000)
"""The form of decision 0116: the same sections, planes coded by one model a bit."""
FIRST_CONTAINER = Container(b"RVNM\x01", "stored neural map", level=12, max_body_bytes=256_000_000)
"""The form until version 0.1: voxels, normals, offsets, hits and features side by side under zstd."""


def pack(header: dict[str, Any], sections: list[bytes], container: Container = CONTAINER) -> bytes:
    """The blob of a JSON-able `header` and `sections`."""
    return container.pack({**header, "sections": [len(one) for one in sections]}, b"".join(sections))


def unpack(blob: bytes, container: Container = CONTAINER) -> tuple[dict[str, Any], list[bytes]]:
    """Header and sections of a blob. Raises DataLoss for anything that `pack` did not write."""
    header, body = container.unpack(blob)
    try:
        ends = [0, *itertools.accumulate(header["sections"])]
        return header, [body[a:b] for a, b in itertools.pairwise(ends)]
    except (TypeError, KeyError) as error:
        raise DataLoss("the stored neural map cannot be read") from error


def is_first_form(blob: bytes) -> bool:
    """Whether a blob is of the form until version 0.1."""
    return blob.startswith(FIRST_CONTAINER.magic)


def container_of(blob: bytes) -> Container:
    """The container of a blob of the second form or of this one."""
    return SECOND_CONTAINER if blob.startswith(SECOND_CONTAINER.magic) else CONTAINER


def from_varint(data: bytes, count: int) -> NDArray[np.int64]:
    """`count` small signed numbers of the first form: zigzag, one byte below 255, else 255 and four more."""
    values = np.frombuffer(data, np.uint8, count).astype(np.int64)
    values[values == 255] = np.frombuffer(data, "<u4", offset=count)
    return np.asarray((values >> 1) ^ -(values & 1))
