"""Pictures made byte by byte: PNG and JPEG files of a few pixels."""

from __future__ import annotations

import struct
import zlib

PNG_BEGIN = b"\x89PNG\r\n\x1a\n"


def part(kind: bytes, content: bytes = b"") -> bytes:
    """A part of a PNG file with its length and sum."""
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def header(width: int, height: int, depth: int = 8, colour: int = 2) -> bytes:
    """The first part of a PNG file."""
    return part(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))


def a_png(width: int = 40, height: int = 30, *more: bytes, red: int = 200) -> bytes:
    """A picture of one colour, with `more` parts before its pixels."""
    row = b"\x00" + bytes((red, 30, 30)) * width
    return (
        PNG_BEGIN + header(width, height) + b"".join(more) + part(b"IDAT", zlib.compress(row * height)) + part(b"IEND")
    )


def segment(marker: int, content: bytes) -> bytes:
    """A part of a JPEG file."""
    return bytes((0xFF, marker)) + struct.pack(">H", 2 + len(content)) + content


def a_jpeg(width: int = 40, height: int = 30, frame: int = 0xC0, coded: bytes = b"\x12\xff\x00\x34") -> bytes:
    """The parts of a grey JPEG in order; its coded data is made up, for readers that do not decode it."""
    size = segment(frame, struct.pack(">BHHB", 8, height, width, 1) + b"\x01\x11\x00")
    return (
        b"\xff\xd8"
        + segment(0xE0, b"JFIF\x00")
        + size
        + segment(0xDA, b"\x01\x01\x00\x00\x3f\x00")
        + coded
        + b"\xff\xd9"
    )
