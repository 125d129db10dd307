"""The disk space of a drive: all files of a service's data, weighed as `du` does."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

BLOCK_BYTES = 512
"""The unit of `st_blocks`, whatever a file system's own blocks are."""

NAMES = {"cloud": "scans", "signature": "places", "neural-map": "neural maps"}
"""The contents of the folders of blobs."""

DATABASE, OTHER, SCANS = "database", "other", "scans"

CONSTANT = ("reserve",)
"""Files of the same size however much is stored."""


@dataclass(frozen=True)
class WeighedStore:
    """The data of a service after one drive: its length, submaps and scans, and bytes on the disk by part."""

    drive: str
    length_m: float
    submaps: int
    scans: int
    parts: Mapping[str, int]

    def megabytes_a_km(self, *, scans: bool) -> float:
        """Megabytes a kilometre of all parts, with or without the scans."""
        kept = sum(size for part, size in self.parts.items() if scans or part != SCANS)
        return 1e-6 * kept / (1e-3 * self.length_m)


def weigh(home: Path) -> dict[str, int]:
    """Bytes on the disk of the data in `home`, by part: kinds of blobs with their folders, the database, the rest."""
    parts: Counter[str] = Counter({DATABASE: 0, OTHER: 0})
    for path in home.rglob("*"):
        if path.name not in CONSTANT:
            parts[_part(path.relative_to(home))] += path.lstat().st_blocks * BLOCK_BYTES
    return dict(parts)


def _part(path: Path) -> str:
    """The part of a store that a path within it belongs to: blobs/TENANT/KIND/..., revisit.db and its side files."""
    if path.parts[0] == "blobs" and len(path.parts) > 2:
        return NAMES.get(path.parts[2], path.parts[2])
    return DATABASE if path.name.startswith("revisit.db") else OTHER


def store_table(stores: Iterable[WeighedStore]) -> str:
    """The stores as a table in Markdown, kilobytes of a submap and megabytes of a kilometre."""
    rows = list(stores)
    parts = sorted({part for row in rows for part in row.parts} - {SCANS, OTHER})
    names = [f"{part}, a submap" for part in parts]
    head = [
        "drive",
        "length",
        "submaps",
        "scans",
        "a scan",
        *names,
        "other, in all",
        "a km without scans",
        "with scans",
    ]
    lines = [head, ["---"] * len(head), *(_cells(row, parts) for row in rows)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _cells(row: WeighedStore, parts: list[str]) -> list[str]:
    sizes = [f"{1e-3 * row.parts.get(part, 0) / max(row.submaps, 1):.1f} kB" for part in parts]
    scan = f"{1e-3 * row.parts.get(SCANS, 0) / max(row.scans, 1):.0f} kB"
    counts = [row.drive, f"{row.length_m:.0f} m", f"{row.submaps}", f"{row.scans}", scan]
    whole = [f"{row.megabytes_a_km(scans=kept):.1f} MB" for kept in (False, True)]
    return [*counts, *sizes, f"{1e-3 * row.parts[OTHER]:.0f} kB", *whole]
