"""A place index that standardises descriptors by the places it holds (docs/decisions/0120)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import AdaptationConfig
from revisit.core.descriptor.adaptation import SiteStatistics, learn_site, learned_from
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
        for row, entry in enumerate(entries, start):
            self.entries.append(entry)
            self.rows[entry.id], self.sessions[row] = row, entry.session
            cell = (entry.session, *np.floor(entry.position / self._cell).astype(np.int64).tolist())
            self.counted[row] = cell not in self._cells
            self.counts[entry.session] += cell not in self._cells
            self._cells.add(cell)

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

    def counted_rows(self, session: int | None = None) -> NDArray[np.intp]:
        """The rows that statistics are learned from, of one session or of all, in order."""
        live = self.live()
        wanted = self.counted[live]
        return live[wanted if session is None else wanted & (self.sessions[live] == session)]

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
        cells = np.array([np.floor(entry.position / self._cell) for entry in self.entries_of(live)]).reshape(-1, 3)
        keys = np.column_stack([self.sessions[live], cells]).astype(np.int64)
        first = np.unique(keys, axis=0, return_index=True)[1]
        self.counted[: len(self.entries)] = False
        self.counted[live[first]] = True
        self._cells = set(map(tuple, keys.tolist()))
        self.counts = Counter(self.sessions[live[first]].tolist())

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
        return len(self._places)

    def add(self, entries: Sequence[IndexEntry], vectors: Array) -> None:
        """See PlaceIndex."""
        normalised = checked_vectors(entries, vectors, self._dimension, self._rows.rows)
        self._rows.append(entries, normalised)
        self._touched.update(entry.session for entry in entries)
        self._places.add(entries, self._adapted(normalised, np.array([e.session for e in entries], dtype=np.int64)))

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
        return self._places.ids()

    def differing(self, entries: Sequence[IndexEntry], vectors: Array) -> list[int]:
        """See PlaceIndex."""
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

    def _learn(self) -> None:
        """Learn what the next step of places asks for: of the whole map, or of single sessions."""
        wanted = learned_from(self._rows.counts.total(), self._config)
        if wanted != self._learned_from_map:
            self._learn_map(wanted)
        if self._site is not None and self._touched:
            self._learn_sessions()

    def _learn_map(self, wanted: int) -> None:
        """Learn from the first `wanted` places that count; sessions follow."""
        rows = self._rows.counted_rows()[:wanted]
        self._learned_from_map, self._learned, self._touched = wanted, {}, set(self._rows.counts)
        before = self._site
        self._site = learn_site(self._rows.vectors[rows], self._rows.sessions[rows], self._config) if wanted else None
        if self._site is not before:
            self._places = self._make_index(self._dimension)
            self._place_again(self._rows.live())

    def _learn_sessions(self) -> None:
        """Learn the means of those sessions that have grown by a step."""
        steps = {session: learned_from(self._rows.counts[session], self._config) for session in self._touched}
        changed = {session: step for session, step in steps.items() if step and step != self._learned.get(session)}
        self._touched = set()
        self._learned.update(changed)
        for session, step in changed.items():
            own = self._rows.counted_rows(session)[:step]
            self._site = self._site and self._site.with_session(session, self._rows.vectors[own])
        live = self._rows.live()
        self._place_again(live[np.isin(self._rows.sessions[live], list(changed))])

    def _place_again(self, rows: NDArray[np.intp]) -> None:
        if len(rows) == 0:
            return
        entries = self._rows.entries_of(rows)
        self._places.remove([entry.id for entry in entries])
        self._places.add(entries, self._adapted(self._rows.vectors[rows], self._rows.sessions[rows]))
