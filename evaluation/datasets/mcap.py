"""MCAP files (https://mcap.dev/spec): where their messages lie, and the messages themselves.

Chunks may be stored plainly or compressed with zstd or LZ4.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from revisit.core.errors import MalformedBody
from revisit.evaluation.datasets.bag_message import (
    ENCODINGS,
    MAX_CHUNK_BYTES,
    DamagedChunk,
    Encoding,
    Message,
    Place,
    type_of_ros_2,
    unpacked_chunk,
)

MAGIC = b"\x89MCAP0\r\n"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 3, 4, 5, 6
_RECORD = struct.Struct("<BQ")


class McapFile:
    """A file that is read in one pass (`messages`) and then message by message (`data`)."""

    def __init__(self, file: Path) -> None:
        """Raises MalformedBody where the file is no MCAP."""
        self.topics: dict[str, str] = {}
        self.cut = ""
        self.damaged = 0
        self._file = file
        self._last: tuple[int, bytes] | None = None
        with file.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise MalformedBody(f"{file.name} is no MCAP file")

    def messages(self) -> Iterator[Message]:
        """All messages of ROS channels, in the order of the file, as far as it goes.

        Those of ROS 1 (`mcap convert`) are of types without `msg`, which are told as those of ROS 2. Raises
        MalformedBody, UnsupportedEncoding.
        """
        schemas: dict[int, str] = {}
        channels: dict[int, tuple[str, str, Encoding]] = {}
        for record, content, place in self._records():
            if record == _SCHEMA:
                schemas[_u16(content, 0)] = _text(content, 2)[0]
            elif record == _CHANNEL:
                topic, after = _text(content, 4)
                encoding, kind = ENCODINGS.get(_text(content, after)[0]), schemas.get(_u16(content, 2), "")
                self.topics[topic] = type_of_ros_2(kind) if encoding == "ros1" else kind
                if encoding is not None:
                    channels[_u16(content, 0)] = topic, self.topics[topic], encoding
            elif record == _MESSAGE and _u16(content, 0) in channels:
                topic, kind, encoding = channels[_u16(content, 0)]
                yield Message(
                    topic, kind, content[22:], Place(place.chunk, place.offset + 22, place.size - 22), encoding
                )

    def data(self, place: Place) -> bytes:
        """The bytes of a message."""
        if place.chunk is not None:
            return self._chunk(place.chunk)[place.offset : place.offset + place.size]
        with self._file.open("rb") as stream:
            stream.seek(place.offset)
            return stream.read(place.size)

    def _records(self) -> Iterator[tuple[int, bytes, Place]]:
        """Records of the file, those of chunks in their stead."""
        end = self._file.stat().st_size
        with self._file.open("rb") as stream:
            at = len(MAGIC)
            while at + _RECORD.size <= end - len(MAGIC):
                stream.seek(at)
                record, size = _RECORD.unpack(stream.read(_RECORD.size))
                start, at = at + _RECORD.size, at + _RECORD.size + size
                if at > end:
                    self.cut = self._file.name
                    return
                if record == _CHUNK:
                    try:
                        yield from _split(self._chunk(start), start)
                    except DamagedChunk:
                        self.damaged += 1
                elif record in (_SCHEMA, _CHANNEL, _MESSAGE):
                    yield record, stream.read(size), Place(None, start, size)

    def _chunk(self, start: int) -> bytes:
        """The records in the chunk at a byte of the file; the last chunk is kept."""
        if self._last is None or self._last[0] != start:
            self._last = start, self._unpacked(start)
        return self._last[1]

    def _unpacked(self, start: int) -> bytes:
        with self._file.open("rb") as stream:
            stream.seek(start)
            _, _, size, checksum, name_size = struct.unpack("<QQQII", stream.read(32))
            compression = stream.read(min(name_size, 64)).decode("ascii", errors="replace")
            (stored,) = struct.unpack("<Q", stream.read(8))
            if max(size, stored) > MAX_CHUNK_BYTES:
                raise MalformedBody(f"{self._file.name} has a chunk of {max(size, stored)} bytes")
            content = stream.read(stored)
        unpacked = unpacked_chunk(content, compression, size)
        if checksum and zlib.crc32(unpacked) != checksum:  # 0: the writer made none
            raise DamagedChunk("the checksum of a chunk does not fit")
        return unpacked


def _split(chunk: bytes, start: int) -> Iterator[tuple[int, bytes, Place]]:
    at = 0
    while at + _RECORD.size <= len(chunk):
        record, size = _RECORD.unpack_from(chunk, at)
        offset, at = at + _RECORD.size, at + _RECORD.size + size
        if at > len(chunk):
            raise DamagedChunk("a chunk ends within a record")
        yield record, chunk[offset:at], Place(start, offset, size)


def _u16(content: bytes, at: int) -> int:
    if at + 2 > len(content):
        raise MalformedBody("a record ends too early")
    return int.from_bytes(content[at : at + 2], "little")


def _text(content: bytes, at: int) -> tuple[str, int]:
    """A string with its length in front, and where the next value begins."""
    if at + 4 > len(content):
        raise MalformedBody("a record ends too early")
    after = at + 4 + int.from_bytes(content[at : at + 4], "little")
    return content[at + 4 : after].decode("utf-8", errors="replace"), after
