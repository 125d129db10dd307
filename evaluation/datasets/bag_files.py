"""The files of a bag: one .mcap, .db3 or .bag, or those that a split recording consists of, read as one."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from revisit.core.errors import BadField, UnsupportedEncoding
from revisit.evaluation.datasets.bag1 import Bag1File
from revisit.evaluation.datasets.bag_message import Bag, Message, Place
from revisit.evaluation.datasets.db3 import Db3File
from revisit.evaluation.datasets.mcap import McapFile

SUFFIXES = (".mcap", ".db3", ".bag")
_METADATA = "metadata.yaml"
_PACKED = (".zstd", ".zst", ".gz", ".bz2", ".lz4", ".xz")
_DATE = re.compile(r"_[0-9]{4}(-[0-9]{2}){5}$")
_LISTED = re.compile(r"^\s*-\s+['\"]?(?P<file>[^'\"]+?)['\"]?\s*$")


class SplitBag:
    """Several files of one recording. A message's place tells its file."""

    def __init__(self, bags: Sequence[Bag]) -> None:
        self.topics: dict[str, str] = {}
        self.cut = ""
        self.damaged = 0
        self._bags = bags

    def messages(self) -> Iterator[Message]:
        """All messages, file by file. Raises MalformedBody, UnsupportedEncoding."""
        for number, bag in enumerate(self._bags):
            for message in bag.messages():
                yield replace(message, place=replace(message.place, file=number))
            self.topics.update(bag.topics)
            self.cut = self.cut or bag.cut
            self.damaged += bag.damaged

    def data(self, place: Place) -> bytes:
        """The bytes of a message."""
        return self._bags[place.file].data(place)


def is_bag(path: Path) -> bool:
    """Whether a file is a bag by its name, or a folder holds one."""
    return path.suffix.lower() in SUFFIXES if path.is_file() else bool(_bags_in(path))


def bags_out_of_sight(folder: Path) -> str:
    """Advice for bags that lie deeper in a folder, or that are not finished or compressed as files; else ""."""
    unfinished = sorted(folder.glob("*.bag.active"))
    if unfinished:
        return f"{unfinished[0].name} was not finished: rename it to .bag, then it is read as far as it goes"
    packed = sorted(file for suffix in SUFFIXES for file in folder.glob(f"*{suffix}.*") if file.suffix in _PACKED)
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
    return SplitBag([openers[file.suffix.lower()](file) for file in files])


def bag_files(path: Path) -> list[Path]:
    """The files of the bag at `path`, a file or a folder, in their order.

    Raises FileNotFoundError where there are none, BadField for several bags or parts that are not all there,
    UnsupportedEncoding where the files or messages as such are compressed.
    """
    if path.is_file():
        if path.suffix.lower() not in SUFFIXES:
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
    if re.search(r"^\s*compression_mode:\s*['\"]?(file|message)\b", text, re.MULTILINE | re.IGNORECASE):
        raise UnsupportedEncoding(
            f"{folder.name} is compressed by file or message: rewrite it with `ros2 bag convert`, uncompressed or with "
            "the chunks of MCAP compressed"
        )
    _, _, after = text.partition("relative_file_paths:\n")
    names = []
    for line in after.splitlines():
        if (found := _LISTED.match(line)) is None:
            break
        names.append(Path(found["file"]).name)
    if not names:
        raise BadField(f"{_METADATA} lists no files: name one of the bags in {folder}", field="folder")
    parts = {_numbered(folder / name)[0] for name in names}
    left = [file.name for file in _bags_in(folder) if file.name not in names and _numbered(file)[0] in parts]
    if left:
        raise BadField(
            f"{_METADATA} does not list {left[0]}, which lies beside the parts that it lists: "
            f"`ros2 bag reindex {folder}` makes it anew",
            field="folder",
        )
    return [_existing(folder / name) for name in names]


def _existing(file: Path) -> Path:
    if file.suffix.lower() not in SUFFIXES:
        raise UnsupportedEncoding(f"{file.name} is no {', '.join(SUFFIXES)} file")
    if not file.is_file():
        raise FileNotFoundError(f"{_METADATA} lists {file.name}, which is not in {file.parent}")
    return file


def _bags_in(folder: Path) -> list[Path]:
    return sorted((file for file in folder.glob("*") if file.suffix.lower() in SUFFIXES), key=_numbered)


def _numbered(file: Path) -> tuple[str, int]:
    """The name of a file without the number that splitting appends, and the number, -1 where it has none.

    The date that `rosbag record --split` writes before the number, another one for each part, is no part of the name.
    """
    name, _, number = file.stem.rpartition("_")
    if not (name and number.isdecimal()):
        return file.name, -1
    return f"{_DATE.sub('', name)}{file.suffix}", int(number)
