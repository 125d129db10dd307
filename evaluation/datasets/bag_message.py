"""Common parts of the readers of bags: a message, its position, and unpacking of chunks within bounds."""

from __future__ import annotations

import bz2
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Protocol

from revisit.core.errors import MalformedBody, TooLarge, UnsupportedEncoding
from revisit.formats.cloud import decompress_zstd

MAX_CHUNK_BYTES = 1 << 30

Encoding = Literal["cdr", "ros1"]

ENCODINGS: dict[str, Encoding] = {"cdr": "cdr", "ros1": "ros1"}
"""By the name that files give them."""


class DamagedChunk(MalformedBody):
    """A chunk is damaged: the messages in it are lost, and no others."""


@dataclass(frozen=True)
class Place:
    """Where a message lies: byte `chunk` of the file, None outside of chunks, then `offset` and `size` within.

    `file` counts the files of a split bag.
    """

    chunk: int | None
    offset: int
    size: int
    file: int = 0


@dataclass(frozen=True)
class Message:
    """A message with its topic, its type as ROS 2 writes it, and how its fields are laid out."""

    topic: str
    message_type: str
    data: bytes
    place: Place
    encoding: Encoding = "cdr"


def type_of_ros_2(type_of_ros_1: str) -> str:
    """A type of messages as ROS 2 writes it: sensor_msgs/PointCloud2 is sensor_msgs/msg/PointCloud2 there."""
    package, _, name = type_of_ros_1.partition("/")
    return f"{package}/msg/{name}"


class Bag(Protocol):
    """A file of messages."""

    topics: dict[str, str]
    """Topic -> type of all that `messages` came across, wanted or not."""
    cut: str
    """The file that `messages` found to end within a record, as after a loss of power; "" where none does."""
    damaged: int
    """Chunks that `messages` found damaged and left out."""

    def messages(self) -> Iterator[Message]:
        """All messages, each with its place."""

    def data(self, place: Place) -> bytes:
        """The bytes of the message at a place."""


def unpacked_chunk(content: bytes, compression: str, size: int) -> bytes:
    """The `size` bytes that a chunk says it holds; never more is unpacked.

    Raises DamagedChunk for damaged data or another size, MalformedBody for a size beyond the limit,
    UnsupportedEncoding for an unknown compression.
    """
    if size > MAX_CHUNK_BYTES:
        raise MalformedBody(f"a chunk of {size} bytes")
    match compression:
        case "" | "none":
            unpacked = content
        case "zstd":
            unpacked = _zstd(content, size)
        case "lz4":
            unpacked = _lz4(content, size)
        case "bz2":
            unpacked = _bz2(content, size)
        case _:
            raise UnsupportedEncoding(f"chunks compressed with {compression[:40]!r}: rewrite the bag with zstd")
    if len(unpacked) != size:
        raise DamagedChunk("a chunk is damaged")
    return unpacked


def _zstd(content: bytes, size: int) -> bytes:
    try:
        return decompress_zstd(content, size)
    except (MalformedBody, TooLarge) as error:
        raise DamagedChunk("a chunk's zstd data is damaged") from error


def _lz4(content: bytes, size: int) -> bytes:
    from lz4.frame import LZ4FrameDecompressor

    try:
        return bytes(LZ4FrameDecompressor().decompress(content, max_length=size))
    except RuntimeError as error:
        raise DamagedChunk("a chunk's LZ4 data is damaged") from error


def _bz2(content: bytes, size: int) -> bytes:
    try:
        return bz2.BZ2Decompressor().decompress(content, max_length=size)
    except OSError as error:
        raise DamagedChunk("a chunk's bzip2 data is damaged") from error
