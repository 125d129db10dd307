"""Recall in maps of a fleet's size: true places among many that are none, by the index that the service uses.

`python -m lab.distractors DRIVE.npz OTHER.npz [OTHER.npz ...]` prints a table for the descriptors of a
drive that `lab.domains` has kept, among places made up from those of other drives.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lab.command_line import run
from revisit.core.index import FaissIndex, IndexEntry, SearchFilter
from revisit.evaluation.metrics import Flags, LoopProtocol, positive_pairs

Vectors = NDArray[np.float32]

VERIFIED_CANDIDATES = 20
SESSION_PLACES = 500
"""How many distractors one made-up drive holds."""

_MOVED = 0.5
_BATCH = 5_000
_SPACING_M = 10.0


@dataclass(frozen=True)
class FleetRecall:
    """recall@1 and recall@20 of a drive's queries among its own earlier places and `distractors` others.

    Seconds are of the processor: to add the distractors, the median search, and the first search, which learns what the
    places have in common.
    """

    distractors: int
    queries: int
    recall_at_1: float
    recall_at_20: float
    add_s: float
    search_s: float
    learn_s: float


def made_up_places(pool: Vectors, count: int, rng: np.random.Generator) -> Vectors:
    """`count` unit descriptors (count, d) of places that do not exist, alike to those of `pool` (n, d).

    The pool must hold no place of the drive that asks: what is made from a query is a view of its place. Each is one of
    the pool moved by half the difference of two others: it varies in the directions, and by 1.2 times as
    much, as real places of such drives do, and stays more like one of them than two places of the pool are to another.
    """
    base, plus, minus = (pool[rng.integers(len(pool), size=count)] for _ in range(3))
    moved = base + _MOVED * (plus - minus)
    return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True), dtype=np.float32)


def fleet_recall(
    vectors: Vectors, positions: NDArray[np.float64], distractors: Vectors, loops: LoopProtocol
) -> FleetRecall:
    """Each place of a drive (n, d), at positions (n, 3), asks its earlier ones and the distractors (m, d)."""
    index = FaissIndex(vectors.shape[1])
    started = time.process_time()
    for start in range(0, len(distractors), _BATCH):
        index.add(_entries(start, len(distractors[start : start + _BATCH])), distractors[start : start + _BATCH])
    added, positives = time.process_time(), positive_pairs(positions, loops)
    seconds, first, found = list[float](), list[bool](), list[bool]()
    for query, vector in enumerate(vectors):
        asked, near = time.process_time(), frozenset(range(query - loops.min_index_gap, query))
        only = SearchFilter(of_session=0, without=near)
        matches = index.search(vector, VERIFIED_CANDIDATES, only) if query else []
        seconds.append(time.process_time() - asked)
        if positives[query].any():
            right = _right([match.id for match in matches], positives[query])
            first.append(bool(right[:1].any()))
            found.append(bool(right.any()))
        index.add([IndexEntry(query, 0, query, positions[query])], vector[None])
    return FleetRecall(
        len(distractors), len(found), float(np.mean(first or [False])), float(np.mean(found or [False])),
        added - started, float(np.median(seconds)), max(seconds),
    )  # fmt: skip


def _right(ids: Sequence[int], positives: Flags) -> Flags:
    """Whether each found place is a true one; ids beyond the drive are distractors."""
    return np.array([identifier < len(positives) and bool(positives[identifier]) for identifier in ids], dtype=bool)


def _entries(start: int, count: int) -> list[IndexEntry]:
    """Distractors are drives of their own, numbered behind every place of the drive that asks."""
    first = 1_000_000
    return [
        IndexEntry(first + row, 1 + row // SESSION_PLACES, row % SESSION_PLACES, np.array([_SPACING_M * row, 1e6, 0.0]))
        for row in range(start, start + count)
    ]


COUNTS = (0, 10_000, 100_000)


def main(drive: Path, others: list[Path]) -> None:
    """Print recall of a drive among places made up from the others; files as `lab.domains` keeps them."""
    with np.load(drive) as kept:
        vectors, positions = kept["vectors"], kept["positions"]
    pool = np.concatenate([np.load(file)["vectors"] for file in others])
    print("| distractors | queries with a loop | recall@1 | recall@20 | add (CPU s) | search (ms) | learn (CPU s) |")
    print("|---|---|---|---|---|---|---|")
    for count in COUNTS:
        distractors = made_up_places(pool, count, np.random.default_rng(7))
        row = fleet_recall(vectors, positions, distractors, LoopProtocol(min_index_gap=15))
        print(
            f"| {count:,} | {row.queries} | {row.recall_at_1:.3f} | {row.recall_at_20:.3f} | {row.add_s:.1f} "
            f"| {1000 * row.search_s:.1f} | {row.learn_s:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    run(main)
