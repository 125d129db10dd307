"""The files of a bag: one .mcap, .db3 or .bag, or those that a split recording consists of, read as one."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import zstandard

from revisit.core.errors import BadField, MalformedBody, TooLarge, UnsupportedEncoding
from revisit.evaluation.datasets.bag1 import Bag1File
from revisit.evaluation.datasets.bag_message import MAX_CHUNK_BYTES, Bag, Message, Place
from revisit.evaluation.datasets.db3 import Db3File
from revisit.evaluation.datasets.mcap import McapFile
from revisit.formats.cloud import decompress_zstd

SUFFIXES = (".mcap", ".db3", ".bag")
_METADATA = "metadata.yaml"
_ZSTD = (".zstd", ".zst")
_OTHERWISE_PACKED = (".gz", ".bz2", ".lz4", ".xz")
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_DATE = re.compile(r"_[0-9]{4}(-[0-9]{2}){5}$")
_LISTED = re.compile(r"^\s*-\s+['\"]?(?P<file>[^'\"]+?)['\"]?\s*$")


class SplitBag:
    """Several files of one recording. A message's place tells its file.

    Messages that ROS 2 compressed one by one are unpacked. `scratch` holds files that were, and goes with the bag.
    """

    def __init__(self, bags: Sequence[Bag], scratch: tempfile.TemporaryDirectory[str] | None = None) -> None:
        self.topics: dict[str, str] = {}
        self.cut = ""
        self.damaged = 0
        self._bags, self._scratch = bags, scratch

    def messages(self) -> Iterator[Message]:
        """All messages, file by file. Raises MalformedBody, UnsupportedEncoding."""
        for number, bag in enumerate(self._bags):
            for message in bag.messages():
                yield replace(message, data=_unpacked(message.data), place=replace(message.place, file=number))
            self.topics.update(bag.topics)
            self.cut = self.cut or bag.cut
            self.damaged += bag.damaged

    def data(self, place: Place) -> bytes:
        """The bytes of a message."""
        return _unpacked(self._bags[place.file].data(place))


def _unpacked(message: bytes) -> bytes:
    """A message without the compression of ROS 2; a damaged one as it is, which then cannot be read.

    The encapsulation header of CDR begins with a zero, and a ROS 1 header with a count: neither is zstd's magic.
    """
    if not message.startswith(_ZSTD_MAGIC):
        return message
    try:
        return decompress_zstd(message, MAX_CHUNK_BYTES)
    except (MalformedBody, TooLarge):
        return message


def is_bag(path: Path) -> bool:
    """Whether a file is a bag by its name, or a folder holds one."""
    return _suffix(path) in SUFFIXES if path.is_file() else bool(_bags_in(path))


def bags_out_of_sight(folder: Path) -> str:
    """Advice for bags that lie deeper in a folder, or that are not finished or compressed as files; else ""."""
    unfinished = sorted(folder.glob("*.bag.active"))
    if unfinished:
        return f"{unfinished[0].name} was not finished: rename it to .bag, then it is read as far as it goes"
    packed = sorted(
        file for suffix in SUFFIXES for file in folder.glob(f"*{suffix}.*") if file.suffix in _OTHERWISE_PACKED
    )
    if packed:
        return f"{packed[0].name} is compressed as a file: unpack it first"
    deeper = sorted({file.parent for suffix in SUFFIXES for file in folder.glob(f"*/**/*{suffix}")})
    return f"there are bags in {', '.join(map(str, deeper[:3]))}: name one of them" if deeper else ""


def open_files(files: Sequence[Path], types: tuple[str, ...]) -> SplitBag:
    """The files as one bag, of which at least the messages of `types` are read. Raises MalformedBody."""
    openers: dict[str, Callable[[Path], Bag]] = {
        ".mcap": McapFile,
        ".bag": Bag1File,
        ".db3": lambda file: Db3File(file, types),
    }
    scratch = None
    if any(_is_packed(file) for file in files):
        scratch = tempfile.TemporaryDirectory(prefix="revisit-bag-")
        files = [_unpacked_file(file, Path(scratch.name)) for file in files]
    return SplitBag([openers[_suffix(file)](file) for file in files], scratch)


def _unpacked_file(file: Path, folder: Path) -> Path:
    """The file itself, or, for one that is compressed as a whole, its content in `folder`. Raises MalformedBody."""
    if not _is_packed(file):
        return file
    unpacked = folder / _plain(file).name
    try:
        with file.open("rb") as packed, unpacked.open("wb") as plain:
            zstandard.ZstdDecompressor().copy_stream(packed, plain)
    except zstandard.ZstdError as error:
        raise MalformedBody(f"{file.name} is damaged: its zstd data cannot be unpacked") from error
    return unpacked


def _is_packed(file: Path) -> bool:
    return file.suffix.lower() in _ZSTD


def _plain(file: Path) -> Path:
    """The name of a file without the ending that says it is compressed."""
    return file.with_suffix("") if _is_packed(file) else file


def _suffix(file: Path) -> str:
    """The kind of a bag by its name."""
    return _plain(file).suffix.lower()


def bag_files(path: Path) -> list[Path]:
    """The files of the bag at `path`, a file or a folder, in their order.

    Raises FileNotFoundError where there are none, BadField for several bags or parts that are not all there.
    """
    if path.is_file():
        if _suffix(path) not in SUFFIXES:
            raise BadField(f"{path.name} is no {', '.join(SUFFIXES)} file", field="folder")
        return [path]
    if (path / _METADATA).is_file():
        return _listed(path)
    files = _bags_in(path)
    if not files:
        raise FileNotFoundError(f"no {', '.join(SUFFIXES)} file in {path}")
    names = {_numbered(file)[0] for file in files}
    if len(files) > 1 and len(names) > 1:
        raise BadField(f"{path} has {len(files)} bags and no {_METADATA}: name one of them", field="folder")
    if len(files) > 1 and [_numbered(file)[1] for file in files] != list(range(len(files))):
        raise BadField(
            f"{files[0].name} to {files[-1].name} in {path} are not all parts of one recording, which are numbered "
            "from 0 on: add those that are missing, or name one file after the other, each with a --session of its own",
            field="folder",
        )
    return files


def _listed(folder: Path) -> list[Path]:
    """The files that the metadata of a ROS 2 bag lists."""
    text = (folder / _METADATA).read_text(errors="replace")
    _, _, after = text.partition("relative_file_paths:\n")
    names = []
    for line in after.splitlines():
        if (found := _LISTED.match(line)) is None:
            break
        names.append(Path(found["file"]).name)
    if not names:
        raise BadField(f"{_METADATA} lists no files: name one of the bags in {folder}", field="folder")
    parts = {_numbered(folder / name)[0] for name in names}
    listed = {_plain(folder / name) for name in names}
    left = [file.name for file in _bags_in(folder) if _plain(file) not in listed and _numbered(file)[0] in parts]
    if left:
        raise BadField(
            f"{_METADATA} does not list {left[0]}, which lies beside the parts that it lists: "
            f"`ros2 bag reindex {folder}` makes it anew",
            field="folder",
        )
    return [_existing(folder / name) for name in names]


def _existing(file: Path) -> Path:
    if _suffix(file) not in SUFFIXES:
        raise UnsupportedEncoding(f"{file.name} is no {', '.join(SUFFIXES)} file")
    if not file.is_file():
        raise FileNotFoundError(f"{_METADATA} lists {file.name}, which is not in {file.parent}")
    return file


def _bags_in(folder: Path) -> list[Path]:
    return sorted((file for file in folder.glob("*") if _suffix(file) in SUFFIXES), key=_numbered)


def _numbered(file: Path) -> tuple[str, int]:
    """The name of a file without the number that splitting appends, and the number, -1 where it has none.

    The date that `rosbag record --split` writes before the number, another one for each part, is no part of the name.
    """
    name, _, number = _plain(file).stem.rpartition("_")
    if not (name and number.isdecimal()):
        return file.name, -1
    return f"{_DATE.sub('', name)}{_suffix(file)}", int(number)
