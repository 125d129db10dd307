"""A checked container for stored numbers: magic, JSON header, zstd body of sections, SHA-256 over all of it."""

from __future__ import annotations

import hashlib
import itertools
import json
import struct
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from revisit.core.errors import DataLoss

MAGIC = b"RVNM\x01"
_DIGEST_BYTES = 32
_MAX_BODY_BYTES = 256_000_000


def pack(header: dict[str, Any], sections: list[bytes]) -> bytes:
    """The blob of a JSON-able `header` and `sections`."""
    head = json.dumps({**header, "sections": [len(one) for one in sections]}, separators=(",", ":")).encode()
    body = zstandard.ZstdCompressor(level=12).compress(b"".join(sections))
    content = MAGIC + struct.pack("<I", len(head)) + head + body
    return content + hashlib.sha256(content).digest()


def unpack(blob: bytes) -> tuple[dict[str, Any], list[bytes]]:
    """Header and sections of a blob. Raises DataLoss for anything that `pack` did not write."""
    content, digest = blob[:-_DIGEST_BYTES], blob[-_DIGEST_BYTES:]
    if not content.startswith(MAGIC) or hashlib.sha256(content).digest() != digest:
        raise DataLoss("the stored neural map is damaged")
    start = len(MAGIC) + 4
    try:
        (size,) = struct.unpack_from("<I", content, len(MAGIC))
        header = json.loads(content[start : start + size])
        body = zstandard.ZstdDecompressor().decompress(content[start + size :], max_output_size=_MAX_BODY_BYTES)
        ends = [0, *itertools.accumulate(header["sections"])]
        return header, [body[a:b] for a, b in itertools.pairwise(ends)]
    except (struct.error, ValueError, TypeError, KeyError, RecursionError, zstandard.ZstdError) as error:
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
