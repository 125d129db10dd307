"""Bags of ROS 1 (.bag, format 2.0): read front to back, so that one without an index is read as well."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from revisit.core.errors import MalformedBody
from revisit.evaluation.datasets.bag_message import (
    MAX_CHUNK_BYTES,
    DamagedChunk,
    Message,
    Place,
    type_of_ros_2,
    unpacked_chunk,
)

MAGIC = b"#ROSBAG V2.0\n"
MAX_HEADER_BYTES = 1 << 20
_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7
_LENGTH = struct.Struct("<I")

Header = dict[bytes, bytes]


class Bag1File:
    """As `McapFile`: read in one pass, then message by message."""

    def __init__(self, file: Path) -> None:
        """Raises MalformedBody where the file is no bag of format 2.0."""
        self.topics: dict[str, str] = {}
        self.cut = ""
        self.damaged = 0
        self._file = file
        self._connections: dict[bytes, tuple[str, str]] = {}
        self._last: tuple[int, bytes] | None = None
        with file.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise MalformedBody(f"{file.name} is no ROS 1 bag of format 2.0")

    def messages(self) -> Iterator[Message]:
        """All messages, in the order of the file, as far as it goes. Raises MalformedBody, UnsupportedEncoding."""
        end = self._file.stat().st_size
        with self._file.open("rb") as stream:
            at = len(MAGIC)
            while at < end:
                record, found = at, _record_if_whole(stream, at, end)
                if found is None:
                    self.cut = self._file.name
                    return
                header, start, size = found
                at = start + size
                if _operation(header) == _CHUNK:
                    try:
                        yield from self._of_chunk(record)
                    except DamagedChunk:
                        self.damaged += 1
                elif _operation(header) in (_MESSAGE, _CONNECTION):
                    stream.seek(start)
                    yield from self._messages_of(header, stream.read(size), Place(None, start, size))

    def data(self, place: Place) -> bytes:
        """The bytes of a message."""
        if place.chunk is not None:
            return self._chunk(place.chunk)[place.offset : place.offset + place.size]
        with self._file.open("rb") as stream:
            stream.seek(place.offset)
            return stream.read(place.size)

    def _messages_of(self, header: Header, content: bytes, place: Place) -> Iterator[Message]:
        """The message of a record; a connection is remembered instead."""
        number = header.get(b"conn", b"")
        if _operation(header) == _CONNECTION:
            topic = header.get(b"topic", b"").decode("utf-8", errors="replace")
            kind = type_of_ros_2(_fields(content).get(b"type", b"").decode("utf-8", errors="replace"))
            self._connections[number] = topic, kind
            self.topics[topic] = kind
        elif number in self._connections:
            yield Message(*self._connections[number], content, place, "ros1")

    def _of_chunk(self, start: int) -> Iterator[Message]:
        chunk, at = self._chunk(start), 0
        while at < len(chunk):
            try:
                header, at = _part(chunk, at)
                content, after = _part(chunk, at)
                fields = _fields(header)
            except MalformedBody as error:
                raise DamagedChunk("a chunk does not hold whole records") from error
            if _operation(fields) in (_MESSAGE, _CONNECTION):
                yield from self._messages_of(fields, content, Place(start, at + _LENGTH.size, len(content)))
            at = after

    def _chunk(self, start: int) -> bytes:
        """The records in the chunk whose record begins at a byte of the file; the last chunk is kept."""
        if self._last is None or self._last[0] != start:
            with self._file.open("rb") as stream:
                header, content_at, size = _record(stream, start)
                if size > MAX_CHUNK_BYTES:
                    raise MalformedBody(f"{self._file.name} has a chunk of {size} bytes")
                stream.seek(content_at)
                content = stream.read(size)
            compression = header.get(b"compression", b"none").decode("ascii", errors="replace")
            self._last = start, unpacked_chunk(content, compression, _number(header.get(b"size", b"")))
        return self._last[1]


def _record(stream: BinaryIO, at: int) -> tuple[Header, int, int]:
    """The header of the record at a byte, where its content begins, and the content's size."""
    stream.seek(at)
    size = _number(stream.read(_LENGTH.size))
    if size > MAX_HEADER_BYTES:
        raise MalformedBody(f"a record with a header of {size} bytes")
    header = _fields(stream.read(size))
    return header, at + 2 * _LENGTH.size + size, _number(stream.read(_LENGTH.size))


def _record_if_whole(stream: BinaryIO, at: int, end: int) -> tuple[Header, int, int] | None:
    """As `_record`; None where the file ends before it, or its header makes no sense: what follows cannot be found."""
    try:
        header, start, size = _record(stream, at)
    except MalformedBody:
        return None
    return (header, start, size) if start + size <= end else None


def _part(content: bytes, at: int) -> tuple[bytes, int]:
    """Bytes with their number in front, and where they end."""
    after = at + _LENGTH.size + _number(content[at : at + _LENGTH.size])
    if after > len(content):
        raise MalformedBody("a record ends too early")
    return content[at + _LENGTH.size : after], after


def _fields(content: bytes) -> Header:
    fields: Header = {}
    at = 0
    while at < len(content):
        field, at = _part(content, at)
        name, equals, value = field.partition(b"=")
        if not equals:
            raise MalformedBody("a field of a record has no value")
        fields[name] = value
    return fields


def _operation(header: Header) -> int:
    return int.from_bytes(header.get(b"op", b""), "little")


def _number(content: bytes) -> int:
    if len(content) != _LENGTH.size:
        raise MalformedBody("a record ends too early")
    return int(_LENGTH.unpack(content)[0])
