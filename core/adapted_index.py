"""A place index that standardises descriptors by the places it holds (docs/decisions/0120)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import AdaptationConfig
from revisit.core.descriptor.adaptation import SiteStatistics, by_session, learn_site, learned_from
from revisit.core.index import (
    SMALLEST_TO_COMPACT,
    IndexEntry,
    Match,
    PlaceIndex,
    SearchFilter,
    checked_vector,
    checked_vectors,
)

Array = NDArray[np.float32]


class _Rows:
    """The descriptors as they came, in the order they came in."""

    def __init__(self, dimension: int, config: AdaptationConfig) -> None:
        self._cell = config.cell
        self._cells: set[tuple[int, ...]] = set()
        self.entries: list[IndexEntry | None] = []
        self.rows: dict[int, int] = {}
        self.counts: Counter[int] = Counter()
        self.sessions = np.zeros(0, dtype=np.int64)
        self.counted = np.zeros(0, dtype=bool)
        self.vectors = np.zeros((0, dimension), dtype=np.float32)

    def append(self, entries: Sequence[IndexEntry], vectors: Array) -> None:
        """Add descriptors that were checked; of places of a session that lie within one cell, the first counts."""
        start, end = len(self.entries), len(self.entries) + len(entries)
        self._reserve(end)
        self.vectors[start:end] = vectors
        self.entries.extend(entries)
        for row, (entry, cell) in enumerate(zip(entries, self._cells_of(entries), strict=True), start):
            self.rows[entry.id], self.sessions[row] = row, entry.session
            self._count(row, cell)

    def drop(self, ids: Sequence[int]) -> bool:
        """Forget descriptors; whether one of them was there."""
        gone = [self.rows.pop(identifier) for identifier in dict.fromkeys(ids) if identifier in self.rows]
        for row in gone:
            self.entries[row] = None
        if gone and (len(self.entries) < SMALLEST_TO_COMPACT or 2 * len(self.rows) <= len(self.entries)):
            self._rebuild()
        elif gone:
            self._count_again()
        return bool(gone)

    def live(self) -> NDArray[np.intp]:
        """The rows that are in use, in order."""
        return np.fromiter(self.rows.values(), np.intp, len(self.rows))

    def counted_rows(self) -> NDArray[np.intp]:
        """The rows that statistics are learned from, in order."""
        live = self.live()
        return live[self.counted[live]]

    def entries_of(self, rows: NDArray[np.intp]) -> list[IndexEntry]:
        """The entries of rows in use."""
        return [entry for row in rows.tolist() if (entry := self.entries[row]) is not None]

    def _rebuild(self) -> None:
        kept = self.live()
        entries, vectors = self.entries_of(kept), self.vectors[kept]
        self.entries, self.rows, self._cells, self.counts = [], {}, set(), Counter()
        self.append(entries, vectors)

    def _count_again(self) -> None:
        live = self.live()
        self.counted[: len(self.entries)] = False
        self.counts, self._cells = Counter(), set()
        for row, cell in zip(live.tolist(), self._cells_of(self.entries_of(live)), strict=True):
            self._count(row, cell)

    def _count(self, row: int, cell: tuple[int, ...]) -> None:
        """Whether a row is the first of its session in its cell, and so counts."""
        first = cell not in self._cells
        self.counted[row] = first
        self.counts[cell[0]] += first
        self._cells.add(cell)

    def _cells_of(self, entries: Sequence[IndexEntry]) -> list[tuple[int, ...]]:
        """The session and the three indices of the cell of each entry."""
        positions = np.array([entry.position for entry in entries]).reshape(-1, 3)
        cells = np.floor(positions / self._cell).astype(np.int64).tolist()
        return [(entry.session, *cell) for entry, cell in zip(entries, cells, strict=True)]

    def _reserve(self, wanted: int) -> None:
        extra = max(wanted, 2 * len(self.sessions), SMALLEST_TO_COMPACT) - len(self.sessions)
        if wanted <= len(self.sessions):
            return
        self.sessions = np.concatenate([self.sessions, np.zeros(extra, np.int64)])
        self.counted = np.concatenate([self.counted, np.zeros(extra, bool)])
        self.vectors = np.concatenate([self.vectors, np.zeros((extra, self.vectors.shape[1]), np.float32)])


class AdaptedIndex:
    """A `PlaceIndex` whose similarities are cosines of descriptors standardised by its own places.

    What it answers depends only on the places it holds and on the order in which they came. A query takes the mean of
    the session that `SearchFilter.near` names, else the map's. Statistics are learned at a search, where enough places
    have come since the last time. Costs twice the memory of the index inside.
    """

    def __init__(
        self, dimension: int, make_index: Callable[[int], PlaceIndex], config: AdaptationConfig = AdaptationConfig()
    ) -> None:
        """`make_index` gives an empty index for the standardised descriptors of `dimension` entries."""
        self._make_index = make_index
        self._config = config
        self._dimension = dimension
        self._places = make_index(dimension)
        self._rows = _Rows(dimension, config)
        self._site: SiteStatistics | None = None
        self._learned: dict[int, int] = {}  # from how many places of each session
        self._learned_from_map = 0
        self._touched: set[int] = set()

    def __len__(self) -> int:
        return len(self._rows.rows)

    def add(self, entries: Sequence[IndexEntry], vectors: Array) -> None:
        """See PlaceIndex."""
        normalised = checked_vectors(entries, vectors, self._dimension, self._rows.rows)
        self._rows.append(entries, normalised)
        self._touched.update(entry.session for entry in entries)
        if not self._due():  # else all are placed anew at the next question
            sessions = np.array([entry.session for entry in entries], dtype=np.int64)
            self._places.add(entries, self._adapted(normalised, sessions))

    def remove(self, ids: Sequence[int]) -> None:
        """See PlaceIndex."""
        self._places.remove(ids)
        if self._rows.drop(ids):
            self._learned_from_map = -1  # what was learned may rest on them

    def search(self, vector: Array, k: int, only: SearchFilter = SearchFilter()) -> list[Match]:
        """See PlaceIndex."""
        query = checked_vector(vector, self._dimension)
        self._learn()
        session = -1 if only.near is None else only.near[0]
        return self._places.search(self._adapted(query[None], np.array([session]))[0], k, only)

    def ids(self) -> NDArray[np.int64]:
        """See PlaceIndex."""
        self._learn()
        return self._places.ids()

    def differing(self, entries: Sequence[IndexEntry], vectors: Array) -> list[int]:
        """See PlaceIndex."""
        self._learn()
        expected = checked_vectors(entries, vectors, self._dimension, {})
        rows = [self._rows.rows.get(entry.id) for entry in entries]
        others = [
            row is None or self._rows.vectors[row].tobytes() != vector.tobytes()
            for row, vector in zip(rows, expected, strict=True)
        ]
        sessions = np.array([entry.session for entry in entries], dtype=np.int64)
        inside = set(self._places.differing(entries, self._adapted(expected, sessions)) if entries else ())
        return [entry.id for entry, other in zip(entries, others, strict=True) if other or entry.id in inside]

    def _adapted(self, vectors: Array, sessions: NDArray[np.int64]) -> Array:
        return vectors if self._site is None else self._site.adapted(vectors, sessions)

    def _due(self) -> bool:
        """Whether the map has grown by a step, or has lost places that were learned from."""
        return self._learned_from_map != learned_from(self._rows.counts.total(), self._config)

    def _learn(self) -> None:
        """Learn what the next step of places asks for, of the whole map or of single sessions, and place them anew."""
        due = self._due()
        if due:
            self._learn_map(learned_from(self._rows.counts.total(), self._config))
        changed = self._learn_sessions() if self._site is not None and self._touched else []
        live = self._rows.live()
        if due:
            self._places = self._make_index(self._dimension)
            self._place(live)
        elif changed:
            rows = live[np.isin(self._rows.sessions[live], changed)]
            self._places.remove([entry.id for entry in self._rows.entries_of(rows)])
            self._place(rows)

    def _learn_map(self, wanted: int) -> None:
        """Learn from the first `wanted` places that count; the sessions follow."""
        rows = self._rows.counted_rows()[:wanted]
        self._learned_from_map, self._learned, self._touched = wanted, {}, set(self._rows.counts)
        self._site = learn_site(self._rows.vectors[rows], self._rows.sessions[rows], self._config) if wanted else None

    def _learn_sessions(self) -> list[int]:
        """Learn the means of those sessions that have grown by a step; which they are."""
        steps = {session: learned_from(self._rows.counts[session], self._config) for session in self._touched}
        changed = {session: step for session, step in steps.items() if step and step != self._learned.get(session)}
        self._touched = set()
        self._learned.update(changed)
        if self._site is not None and changed:
            counted = self._rows.counted_rows()
            for session, own in by_session(self._rows.sessions[counted]):
                if session in changed:
                    self._site = self._site.with_session(session, self._rows.vectors[counted[own[: changed[session]]]])
        return list(changed)

    def _place(self, rows: NDArray[np.intp]) -> None:
        if len(rows):
            adapted = self._adapted(self._rows.vectors[rows], self._rows.sessions[rows])
            self._places.add(self._rows.entries_of(rows), adapted)
