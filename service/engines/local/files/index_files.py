"""Files of indexes: descriptors, codes and statistics of a map's places, mapped read-only by every process.

A file is a copy that proves itself. The row of its map names it, with the hash of its header; the header has the hashes
of its arrays; each descriptor is checked by its mark when it is read. So a file of another database, of an older state
of this one, cut off or half written is not used, and nothing of it is synced to the disk.

The descriptors come first, so that each begins at a page. Behind them the marks, the other arrays, the header (JSON)
and its length.
"""

from __future__ import annotations

import hashlib
import io
import json
import mmap
import os
import re
import secrets
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import structlog
from numpy.typing import NDArray

from revisit.service.engines.local.files.disk import erase_in_place, make_directories, replaceable_write

if TYPE_CHECKING:
    from revisit.core.index import StoredIndex

LAYOUT = 1
"""Of the file: another number is another layout, which this version does not read."""

_LENGTH_BYTES = 8
_PORTION_BYTES = 2**20
_NAME = re.compile(r"([0-9a-f]{16})-([0-9a-f]{64})")
_ROOM_FOR = 2
"""A file is written where the disk has room for so many of its size."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class OpenedIndex:
    """A file as of change `seq`: `vectors` (n, d) are mapped, `marks` (n,) and `arrays` are in memory."""

    seq: int
    vectors: NDArray[np.float32]
    marks: NDArray[np.uint64]
    arrays: Mapping[str, NDArray[Any]]


class IndexFiles:
    """The folder of the files. One process writes, any may read."""

    def __init__(self, folder: Path) -> None:
        """`folder` is made with the first file."""
        self._folder = folder

    def write(self, seq: int, stored: StoredIndex) -> str | None:
        """Store an index as of change `seq`; the name of its file, None where the disk has no room. Raises OSError."""
        make_directories(self._folder, self._folder)
        disk = os.statvfs(self._folder)
        size = (
            sum(array.nbytes for array in stored.arrays.values()) + len(stored.vectors) * 4 * stored.vectors.dimension
        )
        if disk.f_bavail * disk.f_frsize < _ROOM_FOR * size:
            return None
        token, content = secrets.token_hex(8), _Content(seq, stored)
        replaceable_write(self._folder / token, content.pieces())
        return f"{token}-{content.header_sha256}"

    def open(self, name: str, *, whole: bool = False) -> OpenedIndex | None:
        """The index that `write` named so; None if it is missing or damaged.

        `whole`: nor where the disk cannot read all of it. Touching such a page of a mapped file ends the process.
        """
        path, sha256 = self._of(name)
        try:
            with path.open("rb", buffering=0) as file:
                if whole:
                    _read_through(file)
                return _opened(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), sha256)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError) as error:
            log.warning("index_file_not_used", name=name, reason=str(error) or type(error).__name__)
            return None

    def erase(self, name: str, rows: NDArray[np.intp], row_bytes: int) -> None:
        """Overwrite the descriptors of those rows with zeros. Raises OSError."""
        path, _ = self._of(name)
        erase_in_place(path, [int(row) * row_bytes for row in rows], row_bytes)

    def keep(self, names: Collection[str]) -> None:
        """Delete every other file."""
        kept = {self._of(name)[0] for name in names}
        for path in self._folder.iterdir() if self._folder.is_dir() else ():
            if path not in kept:
                path.unlink(missing_ok=True)

    def exists(self, name: str) -> bool:
        """Whether there is such a file."""
        return self._of(name)[0].exists()

    def delete(self, name: str) -> None:
        """Delete one file; processes that have it open keep their view until they close it."""
        self._of(name)[0].unlink(missing_ok=True)

    def _of(self, name: str) -> tuple[Path, str]:
        match = _NAME.fullmatch(name)
        if match is None:
            raise ValueError(f"{name!r} names no file of an index")
        return self._folder / match[1], match[2]


class _Content:
    """The bytes to write, piece by piece; the hash of the header is known at the end."""

    def __init__(self, seq: int, stored: StoredIndex) -> None:
        self._seq = seq
        self._stored = stored
        self.header_sha256 = ""

    def pieces(self) -> Iterator[bytes]:
        """The bytes of the file in order. Raises RowDiffers."""
        marks, at = [], 0
        for vectors, marked in self._stored.portions():
            marks.append(marked)
            yield (piece := vectors.astype("<f4").tobytes())
            at += len(piece)
        parts = {}
        for name, array in {"marks": np.concatenate(marks), **self._stored.arrays}.items():
            little = array.astype(array.dtype.newbyteorder("<"))
            piece = little.tobytes()
            parts[name] = {"dtype": little.dtype.str, "shape": array.shape, "at": at, "sha256": _sha256(piece)}
            at += len(piece)
            yield piece
        about = {"layout": LAYOUT, "seq": self._seq, "dimension": self._stored.vectors.dimension, "parts": parts}
        header = json.dumps(about).encode()
        self.header_sha256 = _sha256(header)
        yield header
        yield len(header).to_bytes(_LENGTH_BYTES, "little")


def _opened(mapped: mmap.mmap, sha256: str) -> OpenedIndex:
    """Raises ValueError, KeyError."""
    about = json.loads(_header(mapped, sha256))
    if about["layout"] != LAYOUT:
        raise ValueError("another layout")
    arrays = {name: _array(mapped, part) for name, part in about["parts"].items()}
    marks, dimension = arrays.pop("marks"), about["dimension"]
    vectors = np.frombuffer(mapped, "<f4", len(marks) * dimension).reshape(len(marks), dimension)
    return OpenedIndex(about["seq"], vectors, marks, arrays)


def _read_through(file: io.FileIO) -> None:
    """Raises OSError."""
    portion = bytearray(_PORTION_BYTES)
    while file.readinto(portion):
        pass


def _header(mapped: mmap.mmap, sha256: str) -> bytes:
    end = len(mapped) - _LENGTH_BYTES
    start = end - int.from_bytes(mapped[max(end, 0) :], "little")
    header = mapped[start:end] if 0 <= start < end else b""
    if _sha256(header) != sha256:
        raise ValueError("it is not the file that its map names")
    return header


def _array(mapped: mmap.mmap, part: Mapping[str, Any]) -> NDArray[Any]:
    kind, shape = np.dtype(part["dtype"]), tuple(part["shape"])
    size = kind.itemsize * int(np.prod(shape, dtype=np.int64))
    content = mapped[part["at"] : part["at"] + size]
    if _sha256(content) != part["sha256"]:
        raise ValueError("a part of it is damaged")
    return np.frombuffer(bytearray(content), kind).reshape(shape)


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
