"""The stored form of a neural map: sections of bytes in a checked container."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from revisit.core.codec.container import Container, decompressed, refuse_former
from revisit.core.errors import DataLoss

CONTAINER = Container(b"RVNM\x04", "stored neural map", level=12, max_body_bytes=256_000_000, digest_bytes=16)
FORMER_MAGICS = (b"RVNM\x01", b"RVNM\x02", b"RVNM\x03")

_SIMILARITY_BYTES = 128
_MAX_MOMENTS_BYTES = 8_000_000


def pack(header: dict[str, Any], sections: list[bytes]) -> bytes:
    """The blob of a JSON-able `header` and `sections`."""
    return CONTAINER.pack({**header, "sections": [len(one) for one in sections]}, b"".join(sections))


def unpack(blob: bytes) -> tuple[dict[str, Any], list[bytes]]:
    """Header and sections of a blob. Raises FormerForm, DataLoss for anything else that `pack` did not write."""
    refuse_former(blob, FORMER_MAGICS, CONTAINER.noun)
    header, body = CONTAINER.unpack(blob)
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
    """The similarity and the differences of stamps."""
    moments = decompressed(section, _MAX_MOMENTS_BYTES, CONTAINER.noun)
    return moments[:_SIMILARITY_BYTES], moments[_SIMILARITY_BYTES:]
