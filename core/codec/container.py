"""Stored numbers: a checked container of magic, lengths, JSON header, zstd body and SHA-256, and its parts."""

from __future__ import annotations

import hashlib
import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from revisit.core.errors import DataLoss, FormerForm


@dataclass(frozen=True)
class Container:
    """One form of stored blob.

    `magic` begins it and names its version; `noun` stands in messages. The header's length follows and, with
    `body_length`, that of the compressed body, 32 bits each. The last `digest_bytes` are those of the SHA-256 of all
    before. A body is never unpacked beyond `max_body_bytes`.
    """

    magic: bytes
    noun: str
    level: int
    max_body_bytes: int
    digest_bytes: int = 32
    body_length: bool = False

    def pack(self, header: dict[str, Any], body: bytes) -> bytes:
        """The blob of a JSON-able `header` and `body`."""
        head = json.dumps(header, separators=(",", ":")).encode()
        packed = zstandard.ZstdCompressor(level=self.level).compress(body)
        lengths = [len(head), len(packed)] if self.body_length else [len(head)]
        content = self.magic + struct.pack(f"<{len(lengths)}I", *lengths) + head + packed
        return content + self._digest(content)

    def unpack(self, blob: bytes) -> tuple[dict[str, Any], bytes]:
        """Header and body of a blob. Raises DataLoss for anything that `pack` did not write."""
        content, digest = blob[: -self.digest_bytes], blob[-self.digest_bytes :]
        if not content.startswith(self.magic):
            raise DataLoss(f"not a {self.noun} of this version")
        if self._digest(content) != digest:
            raise DataLoss(f"the checksum of the {self.noun} does not fit")
        try:
            return self._opened(content)
        except (struct.error, ValueError, RecursionError) as error:
            raise DataLoss(f"the {self.noun} cannot be read") from error

    def _opened(self, content: bytes) -> tuple[dict[str, Any], bytes]:
        lengths = struct.unpack_from("<2I" if self.body_length else "<I", content, len(self.magic))
        start = len(self.magic) + 4 * len(lengths)
        header, packed = json.loads(content[start : start + lengths[0]]), content[start + lengths[0] :]
        if not isinstance(header, dict):
            raise DataLoss(f"the header of the {self.noun} is not an object")
        if self.body_length and len(packed) != lengths[1]:
            raise DataLoss(f"the {self.noun} is cut short or has bytes too many")
        return header, decompressed(packed, self.max_body_bytes, self.noun)

    def _digest(self, content: bytes) -> bytes:
        return hashlib.sha256(content).digest()[: self.digest_bytes]


def refuse_former(blob: bytes, magics: tuple[bytes, ...], noun: str) -> None:
    """Raises FormerForm for a blob that begins with one of `magics`, of what is made of scans and can be made anew."""
    if blob.startswith(magics):
        raise FormerForm(noun, "`revisit reembed MAP` describes the submaps of its map again")


def decompressed(packed: bytes, max_bytes: int, noun: str) -> bytes:
    """The content of a zstd frame, at most `max_bytes`. Raises DataLoss for a larger or damaged one."""
    try:
        # A frame that announces its size is unpacked whole and ignores `max_output_size`.
        if zstandard.frame_content_size(packed) > max_bytes:
            raise DataLoss(f"the {noun} is too large")
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=max_bytes)
    except zstandard.ZstdError as error:
        raise DataLoss(f"the {noun} cannot be read") from error


def to_byte_planes(rows: NDArray[np.generic]) -> bytes:
    """Rows (n, w) of 4-byte numbers, column by column: all first bytes, then all second ones, ..., easy to compress."""
    return np.ascontiguousarray(np.ascontiguousarray(rows.T).view(np.uint8).reshape(-1, 4).T).tobytes()


def from_byte_planes(planes: bytes, width: int, dtype: str) -> NDArray[Any]:
    """The rows (n, width) of `to_byte_planes`."""
    columns = np.ascontiguousarray(np.frombuffer(planes, dtype=np.uint8).reshape(4, -1).T).view(dtype)
    return columns.reshape(width, -1).T
