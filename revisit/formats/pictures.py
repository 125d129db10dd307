"""PNG and JPEG by their bytes: kind and size of a picture, for servers that show none.

A strict walk over the parts of a file. No pixel is decoded. A file is one picture from its first byte to its last:
bytes behind its end are refused, and with them archives, pages and programs in its clothing. Sources: PNG, third
edition (W3C 2025); ITU-T T.81 (JPEG).
"""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass

from revisit.core.errors import MalformedBody, TooLarge, UnsupportedEncoding

PNG, JPEG = "image/png", "image/jpeg"

PNG_BEGIN, JPEG_BEGIN = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"

MOST_PARTS = 20_000
"""Parts of a file that are looked at: encoders write some thousand, of 4 KiB and more."""

MOST_SCANS = 100
"""Of a progressive JPEG, which a browser decodes one after the other over the whole picture."""

_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
"""Bits a sample may have, by the colour type of a PNG."""

_FRAMES = (0xC0, 0xC1, 0xC2)
"""Baseline, extended and progressive: those that browsers decode."""

_OTHER_FRAMES = frozenset({0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF})

_MARKER = re.compile(rb"\xff+[^\x00\xd0-\xd8\xff]")
"""The name of a part, with bytes before it that fill (ITU-T T.81, B.1.1.2)."""

_NEXT_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
"""In coded data: neither a stuffed byte nor a restart."""


@dataclass(frozen=True)
class Picture:
    """The kind of a picture, PNG or JPEG, and its size as its bytes have it, pixels."""

    media_type: str
    width: int
    height: int


@dataclass(frozen=True)
class PictureLimits:
    """The most that a picture may have."""

    megapixels: int
    side: int

    def require(self, picture: Picture) -> Picture:
        """The picture. Raises TooLarge."""
        if picture.width * picture.height > self.megapixels * 10**6 or max(picture.width, picture.height) > self.side:
            raise TooLarge(
                f"the picture has {picture.width} x {picture.height} pixels; at most {self.megapixels} megapixels and "
                f"{self.side} pixels a side are taken: make it smaller",
                field="image",
            )
        return picture


def kind_of(data: bytes) -> str:
    """The media type that a file begins like. Raises UnsupportedEncoding for anything but PNG and JPEG."""
    if data.startswith(PNG_BEGIN):
        return PNG
    if data.startswith(JPEG_BEGIN):
        return JPEG
    raise UnsupportedEncoding("a plan is a PNG or a JPEG file; this is neither", field="image")


def read_picture(data: bytes, limits: PictureLimits) -> Picture:
    """Kind and size of a whole file. Raises UnsupportedEncoding, MalformedBody, TooLarge."""
    width, height = _read_png(data) if kind_of(data) == PNG else _read_jpeg(data)
    if not width or not height:
        raise _broken("it has no pixels")
    return limits.require(Picture(kind_of(data), width, height))


def _broken(why: str) -> MalformedBody:
    return MalformedBody(f"the picture is damaged or no plain PNG or JPEG file: {why}", field="image")


def _read_png(data: bytes) -> tuple[int, int]:
    """Width and height, pixels, of a file with parts of the declared lengths, sums and order."""
    at, kinds, size = len(PNG_BEGIN), set[bytes](), (0, 0)
    for number in range(MOST_PARTS):
        kind, content, at = _png_part(data, at)
        if (number == 0) != (kind == b"IHDR"):
            raise _broken("its header is not where it belongs")
        if kind == b"IHDR":
            size = _png_size(content)
        elif kind[:1].isupper() and kind not in (b"PLTE", b"IDAT", b"IEND"):
            raise _broken("it has a part that no reader knows")
        kinds.add(kind)
        if kind == b"IEND":
            if b"IDAT" not in kinds:
                raise _broken("it has no pixels")
            return _whole(size, data, at)
    raise _broken("it has too many parts")


def _png_part(data: bytes, at: int) -> tuple[bytes, bytes, int]:
    """Kind and content of the part at a place, and the place behind it."""
    if len(data) < at + 12:
        raise _broken("it is cut short")
    length, kind = struct.unpack_from(">I4s", data, at)
    end = at + 8 + length
    if len(data) < end + 4:
        raise _broken("it is cut short")
    if not kind.isalpha():
        raise _broken("a part of it has no name")
    if zlib.crc32(memoryview(data)[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
        raise _broken("a part of it does not have its sum")
    return kind, data[at + 8 : end] if kind == b"IHDR" else b"", end + 4


def _png_size(content: bytes) -> tuple[int, int]:
    if len(content) != 13:
        raise _broken("its header has another length")
    width, height, depth, colour, packing, filtering, interlaced = struct.unpack(">IIBBBBB", content)
    if depth not in _DEPTHS.get(colour, ()) or packing or filtering or interlaced > 1:
        raise _broken("its header names no kind of pixels that there is")
    return width, height


def _read_jpeg(data: bytes) -> tuple[int, int]:
    """Width and height, pixels, of a file with one frame of a kind that browsers decode, and an end at its end."""
    at, size, scans = 2, (0, 0), 0
    for _ in range(MOST_PARTS):
        marker, content, at = _jpeg_part(data, at)
        if marker == 0xD9:
            if not scans:
                raise _broken("it has no pixels")
            return _whole(size, data, at)
        if marker in _FRAMES:
            if size != (0, 0):
                raise _broken("it has two headers")
            size = _jpeg_size(content)
        elif marker in _OTHER_FRAMES:
            raise UnsupportedEncoding("no browser shows this kind of JPEG: save it as baseline", field="image")
        elif marker == 0xDA:
            scans += 1
            if size == (0, 0) or scans > MOST_SCANS:
                raise _broken("it has no header before its pixels" if size == (0, 0) else "it has too many scans")
            found = _NEXT_MARKER.search(data, at)
            at = len(data) if found is None else found.start()
    raise _broken("it has too many parts")


def _jpeg_part(data: bytes, at: int) -> tuple[int, bytes, int]:
    """Marker and content of the part at a place, and the place behind it."""
    begin = _MARKER.match(data, at)
    if begin is None:
        raise _broken("it is cut short" if len(data) < at + 2 else "a part of it has no name")
    at = begin.end() - 2
    marker = data[at + 1]
    if marker in (0xD9, 0x01):
        return marker, b"", at + 2
    if len(data) < at + 4:
        raise _broken("it is cut short")
    end = at + 2 + int(struct.unpack_from(">H", data, at + 2)[0])
    if end < at + 4 or len(data) < end:
        raise _broken("it is cut short")
    return marker, data[at + 4 : end], end


def _jpeg_size(content: bytes) -> tuple[int, int]:
    if len(content) < 6:
        raise _broken("its header has another length")
    depth, height, width, components = struct.unpack_from(">BHHB", content)
    if depth != 8 or components not in (1, 3, 4) or len(content) != 6 + 3 * components:
        raise _broken("its header names no kind of pixels that there is")
    return width, height


def _whole(size: tuple[int, int], data: bytes, end: int) -> tuple[int, int]:
    """The size, of a file that ends where its picture does."""
    if end != len(data):
        raise _broken(f"{len(data) - end} bytes follow its end; save it again with a program for pictures")
    return size
