"""The stored form of a neural map: sections of bytes in a checked container, and of the forms before it."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from revisit.core.container import Container, decompressed
from revisit.core.errors import DataLoss

CONTAINER = Container(b"RVNM\x04", "stored neural map", level=12, max_body_bytes=256_000_000, digest_bytes=16)
THIRD_CONTAINER = Container(b"RVNM\x03", "stored neural map", level=12, max_body_bytes=256_000_000)
"""An older form: other sections, a stream without learned chances."""
SECOND_CONTAINER = Container(b"RVNM\x02", "stored neural map", level=12, max_body_bytes=256_000_000)
"""An older form: the sections of the third, planes coded by one model a bit."""
FIRST_CONTAINER = Container(b"RVNM\x01", "stored neural map", level=12, max_body_bytes=256_000_000)
"""The form until version 0.1: voxels, normals, offsets, hits and features side by side under zstd."""
SECOND, THIRD, FOURTH = 2, 3, 4
"""Versions of the stream of points, as the fifth byte says, oldest first; the last one is written."""

_SIMILARITY_BYTES = 128
_MAX_MOMENTS_BYTES = 8_000_000


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


def pack_moments(similarity: NDArray[np.float64], stamps_ns: NDArray[np.int64]) -> bytes:
    """The first section: where and when a map was seen, compressed by itself, because beside a stream nothing is."""
    stamps = np.diff(stamps_ns, prepend=0).astype("<i8").tobytes()
    return zstandard.ZstdCompressor(level=CONTAINER.level).compress(similarity.astype("<f8").tobytes() + stamps)


def unpack_moments(section: bytes) -> tuple[bytes, bytes]:
    """The similarity and the differences of stamps, which are the first two sections of the older forms."""
    moments = decompressed(section, _MAX_MOMENTS_BYTES, CONTAINER.noun)
    return moments[:_SIMILARITY_BYTES], moments[_SIMILARITY_BYTES:]


def is_first_form(blob: bytes) -> bool:
    """Whether a blob is of the form until version 0.1."""
    return blob.startswith(FIRST_CONTAINER.magic)


def version_of(blob: bytes) -> tuple[int, Container]:
    """The version of a blob's stream of points, and its container, of the second form or a later one."""
    older = {THIRD: THIRD_CONTAINER, SECOND: SECOND_CONTAINER}
    for version, container in older.items():
        if blob.startswith(container.magic):
            return version, container
    return FOURTH, CONTAINER


def from_varint(data: bytes, count: int) -> NDArray[np.int64]:
    """`count` small signed numbers of the first form: zigzag, one byte below 255, else 255 and four more."""
    values = np.frombuffer(data, np.uint8, count).astype(np.int64)
    values[values == 255] = np.frombuffer(data, "<u4", offset=count)
    return np.asarray((values >> 1) ^ -(values & 1))
