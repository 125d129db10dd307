"""expected.toml as cases: one is what is sent at one time, and what both transports must answer."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from revisit.formats import KITTI, NPY, PCD, PLY, POINTCLOUD2, QUANTISED
from tests.corpus.clouds import SUFFIXES
from tests.corpus.write import body_of

EXPECTED = Path(__file__).parent / "expected.toml"
MEDIA_TYPES = {
    "bin": KITTI,
    "pcd": PCD,
    "ply": PLY,
    "npy": NPY,
    "pc2": POINTCLOUD2,
    "rvq": QUANTISED,
    "npz": "application/x-npz",
}
UNROTATED = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class CloudToSend:
    """A file with its media type, and the parts of the request around it."""

    body: str
    type: str
    encoding: str | None = None
    pose: tuple[float, ...] = UNROTATED
    stamp_ns: int = 1

    @classmethod
    def read(cls, entry: str | dict[str, Any]) -> CloudToSend:
        """From an entry of `clouds`: the name of a file, or a table."""
        table = {"body": entry} if isinstance(entry, str) else dict(entry)
        if "type" not in table:
            table["type"] = MEDIA_TYPES[table["body"].rpartition(".")[2]]
        return cls(**{**table, "pose": tuple(table.get("pose", UNROTATED))})

    @property
    def data(self) -> bytes:
        """The file."""
        return body_of(self.body)


@dataclass(frozen=True)
class Case:
    """One table of expected.toml, see its head."""

    row: str
    number: int
    case: str
    clouds: tuple[CloudToSend, ...] = ()
    scans: tuple[dict[str, Any], ...] = ()
    rest: tuple[dict[str, Any], ...] = ()
    rpc: tuple[dict[str, Any], ...] = ()
    raw: tuple[Any, ...] = ()
    absent: tuple[str, ...] = ()
    http: tuple[Any, ...] = ()
    grpc: tuple[str, ...] = ()
    answers: tuple[int, ...] = ()
    has: dict[str, Any] = field(default_factory=dict)
    covered_by: tuple[str, ...] = ()
    deviation: str = ""

    @property
    def id(self) -> str:
        """`G44` or, for a further case of a row, `G44-2`."""
        return self.row if self.number == 1 else f"{self.row}-{self.number}"

    @property
    def is_run(self) -> bool:
        """Whether the corpus suite itself sends it (or shows that it cannot be sent)."""
        return bool(self.clouds or self.scans or self.rest or self.rpc or self.raw or self.absent)


def cases() -> list[Case]:
    """All of them, in the order of the file."""
    rows = tomllib.loads(EXPECTED.read_text())
    return [_case(row, number, dict(table)) for row, tables in rows.items() for number, table in enumerate(tables, 1)]


def _case(row: str, number: int, table: dict[str, Any]) -> Case:
    entries = [*table.pop("clouds", ()), *_of_every_format(table.pop("formats", None))]
    clouds = tuple(CloudToSend.read(entry) for entry in entries)
    lists = {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}
    return Case(row=row, number=number, clouds=clouds, **lists)


def _of_every_format(prefix: str | None) -> Iterator[str]:
    if prefix is not None:
        yield from (f"{prefix}.{suffix}" for suffix in SUFFIXES.values())
