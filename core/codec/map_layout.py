"""The bytes of a map file as a list of parts: those that exist as neural maps already are named, not stored again."""

from __future__ import annotations

import hashlib
import io
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any

from typing_extensions import Buffer

from revisit.core.codec.container import Container
from revisit.core.errors import DataLoss

_CONTAINER = Container(b"RVML\x01", "stored layout of a map file", level=3, max_body_bytes=2**30)

PIECE_BYTES = 2**18
"""A file is handed out in pieces of at most so many bytes."""


@dataclass(frozen=True)
class _Part:
    """A run of bytes: `literal` ones, or the neural map of this hash."""

    size: int
    literal: bytes = b""
    sha256: str = ""


class MapLayout:
    """The layout of a map file's bytes."""

    def __init__(self, parts: list[_Part]) -> None:
        """The parts in their order."""
        self._parts = parts
        self._starts = [0, *accumulate(part.size for part in parts)]

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self._starts[-1]

    @property
    def neural_maps(self) -> set[str]:
        """The hashes of those that are named."""
        return {part.sha256 for part in self._parts if part.sha256}

    def pieces(self, read: Callable[[str], bytes], start: int = 0, end: int | None = None) -> Iterator[bytes]:
        """The bytes from `start` to before `end` in pieces; `read` gets a neural map by its hash.

        Raises DataLoss where a neural map is damaged or gone.
        """
        waiting = bytearray()
        for part in self._wanted(read, start, end):
            waiting += part
            while len(waiting) >= PIECE_BYTES:
                yield bytes(waiting[:PIECE_BYTES])
                del waiting[:PIECE_BYTES]
        if waiting:
            yield bytes(waiting)

    def _wanted(self, read: Callable[[str], bytes], start: int, end: int | None) -> Iterator[bytes]:
        """Each part's share of a range."""
        last = self.size if end is None else min(end, self.size)
        for number in range(bisect_right(self._starts, start) - 1, len(self._parts)):
            first = self._starts[number]
            if first >= last:
                return
            part = self._parts[number]
            data = read(part.sha256) if part.sha256 else part.literal
            if len(data) != part.size:
                raise DataLoss("a part of the map file has another size than it had")
            yield data[max(0, start - first) : last - first]

    def hash_with(self, read: Callable[[str], bytes]) -> str:
        """SHA-256 (hex) of the file. Raises DataLoss."""
        digest = hashlib.sha256()
        for piece in self.pieces(read):
            digest.update(piece)
        return digest.hexdigest()

    def to_blob(self) -> bytes:
        """As it is stored."""
        parts = [[part.size, part.sha256] if part.sha256 else [part.size] for part in self._parts]
        return _CONTAINER.pack({"parts": parts}, b"".join(part.literal for part in self._parts))

    @classmethod
    def from_blob(cls, blob: bytes) -> MapLayout:
        """The layout of `to_blob`. Raises DataLoss for damage."""
        header, body = _CONTAINER.unpack(blob)
        parts, offset = [], 0
        try:
            for size, *named in header["parts"]:
                literal = b"" if named else body[offset : offset + size]
                offset += len(literal)
                parts.append(_Part(int(size), literal, str(named[0]) if named else ""))
        except (KeyError, TypeError, ValueError) as error:
            raise DataLoss("the stored layout of a map file cannot be read") from error
        return cls(parts)


@dataclass
class LayoutRecorder(io.RawIOBase):
    """A stream that notes its bytes instead of storing them, and the `known` neural maps by their hashes.

    Written parts can be written over, as archives do with the heads of their members, unless they are neural maps.
    """

    known: Collection[str]
    _parts: list[_Part | bytearray] = field(default_factory=list)
    _starts: list[int] = field(default_factory=list)
    _size: int = 0
    _at: int = 0

    def write(self, data: Buffer) -> int:
        """Note bytes at the position."""
        piece = bytes(data)
        if self._at < self._size:
            self._overwrite(piece)
        else:
            self._append(piece)
        self._at += len(piece)
        return len(piece)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Go to a position."""
        self._at = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence]
        return self._at

    def tell(self) -> int:
        """The position."""
        return self._at

    def seekable(self) -> bool:
        """It is."""
        return True

    def writable(self) -> bool:
        """It is."""
        return True

    def layout(self) -> MapLayout:
        """The noted layout."""
        parts: list[Any] = self._parts
        return MapLayout([one if isinstance(one, _Part) else _Part(len(one), bytes(one)) for one in parts])

    def _append(self, piece: bytes) -> None:
        sha256 = hashlib.sha256(piece).hexdigest()
        if sha256 in self.known:
            self._add(_Part(len(piece), sha256=sha256))
        elif self._parts and isinstance(last := self._parts[-1], bytearray):
            last.extend(piece)
        else:
            self._add(bytearray(piece))
        self._size += len(piece)

    def _add(self, part: _Part | bytearray) -> None:
        self._parts.append(part)
        self._starts.append(self._size)

    def _overwrite(self, piece: bytes) -> None:
        number = bisect_right(self._starts, self._at) - 1
        part, offset = self._parts[number], self._at - self._starts[number]
        if not isinstance(part, bytearray) or offset + len(piece) > len(part):
            raise io.UnsupportedOperation("only heads of members can be written over")
        part[offset : offset + len(piece)] = piece
