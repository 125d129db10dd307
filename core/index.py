"""Nearest descriptors under filters (paper III-E, Eq. 15): an exact reference and FAISS."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import faiss
import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField

Array = NDArray[np.float32]
Flags = NDArray[np.bool_]

MAX_K = 1000
SMALLEST_TO_COMPACT = 64
"""Fewer rows than this are not worth copying."""


@dataclass(frozen=True)
class IndexEntry:
    """What filters know of a stored place: its id, session, ordinal in the session and position (3,) metres."""

    id: int
    session: int
    ordinal: int
    position: NDArray[np.float64]


@dataclass(frozen=True)
class SearchFilter:
    """Which places may be found; every condition that is given must hold.

    near = (session, ordinal, min_gap): not the places of that session whose ordinals differ by less than min_gap.
    position (3,) and radius_m: only places at most that far away. allowed: only these ids.
    """

    exclude_session: int | None = None
    only_session: int | None = None
    near: tuple[int, int, int] | None = None
    position: NDArray[np.float64] | None = None
    radius_m: float | None = None
    allowed: frozenset[int] | None = None


@dataclass(frozen=True)
class Match:
    """A found place and its cosine similarity."""

    id: int
    similarity: float


class PlaceIndex(Protocol):
    """Unit vectors of places with their metadata; search finds exactly the most similar ones."""

    def add(self, entries: Sequence[IndexEntry], vectors: Array) -> None:
        """Store vectors (n, d), which are L2-normalised.

        Raises BadField for another length, NaN, infinity, a zero vector or an id that is stored already or twice in
        `entries`; then nothing is stored.
        """

    def remove(self, ids: Sequence[int]) -> None:
        """Forget places; unknown ids are ignored."""

    def search(self, vector: Array, k: int, only: SearchFilter = ...) -> list[Match]:
        """At most min(k, 1000) places by falling similarity, ties by id. k < 1 or an unusable vector: BadField."""

    def __len__(self) -> int:
        """How many places are stored."""

    def ids(self) -> NDArray[np.int64]:
        """The ids of the vectors that a search compares with."""

    def differing(self, entries: Sequence[IndexEntry], vectors: Array) -> list[int]:
        """The ids of those `entries` that are not stored as `add` would store them, bit for bit. Raises BadField."""


class _Metadata:
    """The entries' fields as growing arrays, so that a filter is a few comparisons. Rows keep their order."""

    def __init__(self) -> None:
        self.rows: dict[int, int] = {}
        self.count = 0
        self.ids = np.zeros(0, dtype=np.int64)
        self.sessions = np.zeros(0, dtype=np.int64)
        self.ordinals = np.zeros(0, dtype=np.int64)
        self.positions = np.zeros((0, 3))
        self.alive = np.zeros(0, dtype=bool)

    def append(self, entries: Sequence[IndexEntry]) -> None:
        """Add rows for entries whose ids are new."""
        self._reserve(self.count + len(entries))
        for entry in entries:
            row = self.count
            self.rows[entry.id] = row
            self.ids[row], self.sessions[row], self.ordinals[row] = entry.id, entry.session, entry.ordinal
            self.positions[row] = entry.position
            self.alive[row] = True
            self.count += 1

    def drop(self, ids: Sequence[int]) -> NDArray[np.int64]:
        """Mark rows as removed; the ids that were there."""
        known = [identifier for identifier in dict.fromkeys(ids) if identifier in self.rows]
        for identifier in known:
            self.alive[self.rows.pop(identifier)] = False
        return np.array(known, dtype=np.int64)

    def compact(self) -> NDArray[np.intp] | None:
        """Give removed rows back once they are most of all; which rows were kept, None where nothing has changed."""
        if self.count < SMALLEST_TO_COMPACT or 2 * len(self.rows) > self.count:
            return None
        kept = np.flatnonzero(self.alive[: self.count])
        self.ids, self.sessions, self.ordinals = self.ids[kept], self.sessions[kept], self.ordinals[kept]
        self.positions, self.alive = self.positions[kept], self.alive[kept]
        self.rows = {identifier: row for row, identifier in enumerate(self.ids.tolist())}
        self.count = len(kept)
        return kept

    def holds(self, entry: IndexEntry) -> bool:
        """Whether the entry is there with these fields."""
        row = self.rows.get(entry.id)
        return row is not None and bool(
            self.alive[row]
            and (self.ids[row], self.sessions[row], self.ordinals[row]) == (entry.id, entry.session, entry.ordinal)
            and np.array_equal(self.positions[row], entry.position)
        )

    def passing(self, only: SearchFilter) -> Flags:
        """Which rows (count,) satisfy the filter."""
        sessions, ordinals = self.sessions[: self.count], self.ordinals[: self.count]
        keep = self.alive[: self.count].copy()
        if only.exclude_session is not None:
            keep &= sessions != only.exclude_session
        if only.only_session is not None:
            keep &= sessions == only.only_session
        if only.near is not None:
            session, ordinal, gap = only.near
            keep &= (sessions != session) | (np.abs(ordinals - ordinal) >= gap)
        if only.position is not None and only.radius_m is not None:
            distance = np.linalg.norm(self.positions[: self.count] - only.position, axis=1)
            keep &= distance <= only.radius_m
        if only.allowed is not None:
            keep &= np.isin(self.ids[: self.count], np.fromiter(only.allowed, np.int64, len(only.allowed)))
        return keep

    def _reserve(self, wanted: int) -> None:
        if wanted <= len(self.ids):
            return
        extra = max(wanted, 2 * len(self.ids), 64) - len(self.ids)
        self.ids = np.concatenate([self.ids, np.zeros(extra, np.int64)])
        self.sessions = np.concatenate([self.sessions, np.zeros(extra, np.int64)])
        self.ordinals = np.concatenate([self.ordinals, np.zeros(extra, np.int64)])
        self.positions = np.concatenate([self.positions, np.zeros((extra, 3))])
        self.alive = np.concatenate([self.alive, np.zeros(extra, bool)])


class ExactIndex:
    """The reference: one matrix product over every place that passes the filter."""

    def __init__(self, dimension: int) -> None:
        self._dimension = dimension
        self._metadata = _Metadata()
        self._vectors = np.zeros((0, dimension), dtype=np.float32)

    def __len__(self) -> int:
        return len(self._metadata.rows)

    def add(self, entries: Sequence[IndexEntry], vectors: Array) -> None:
        """See PlaceIndex."""
        normalised = checked_vectors(entries, vectors, self._dimension, self._metadata.rows)
        self._metadata.append(entries)
        self._vectors = np.concatenate([self._vectors, normalised])

    def remove(self, ids: Sequence[int]) -> None:
        """See PlaceIndex."""
        self._metadata.drop(ids)
        kept = self._metadata.compact()
        if kept is not None:
            self._vectors = self._vectors[kept]

    def search(self, vector: Array, k: int, only: SearchFilter = SearchFilter()) -> list[Match]:
        """See PlaceIndex."""
        query, k = _checked_query(vector, k, self._dimension)
        rows = np.flatnonzero(self._metadata.passing(only))
        return _ranked(self._metadata.ids[rows], self._vectors[rows] @ query, k)

    def ids(self) -> NDArray[np.int64]:
        """See PlaceIndex."""
        return self._metadata.ids[: self._metadata.count][self._metadata.alive[: self._metadata.count]]

    def differing(self, entries: Sequence[IndexEntry], vectors: Array) -> list[int]:
        """See PlaceIndex."""
        count = self._metadata.count
        return _differing(self._metadata, entries, vectors, self._metadata.ids[:count], self._vectors)


class FaissIndex:
    """FAISS exact inner product; filters become an id selector, so the recall under a filter is 1."""

    def __init__(self, dimension: int) -> None:
        faiss.omp_set_num_threads(1)  # parallelism is by processes
        self._dimension = dimension
        self._metadata = _Metadata()
        self._faiss = faiss.IndexIDMap2(faiss.IndexFlatIP(dimension))

    def __len__(self) -> int:
        return len(self._metadata.rows)

    def add(self, entries: Sequence[IndexEntry], vectors: Array) -> None:
        """See PlaceIndex."""
        normalised = checked_vectors(entries, vectors, self._dimension, self._metadata.rows)
        if len(entries):
            self._faiss.add_with_ids(normalised, np.array([entry.id for entry in entries], dtype=np.int64))
        self._metadata.append(entries)

    def remove(self, ids: Sequence[int]) -> None:
        """See PlaceIndex."""
        known = self._metadata.drop(ids)
        if len(known):
            self._faiss.remove_ids(faiss.IDSelectorBatch(known))
            self._metadata.compact()

    def search(self, vector: Array, k: int, only: SearchFilter = SearchFilter()) -> list[Match]:
        """See PlaceIndex."""
        query, k = _checked_query(vector, k, self._dimension)
        allowed = self._metadata.ids[: self._metadata.count][self._metadata.passing(only)]
        if len(allowed) == 0:
            return []
        # one more than asked, until the last is clearly worse than the k-th: FAISS cuts ties arbitrarily
        wanted = min(k + 8, len(allowed))
        while True:
            similarities, ids = self._search(query, wanted, allowed)
            if wanted == len(allowed) or similarities[-1] < similarities[k - 1]:
                return _ranked(ids, similarities, k)
            wanted = min(2 * wanted, len(allowed))

    def ids(self) -> NDArray[np.int64]:
        """See PlaceIndex."""
        return np.asarray(faiss.vector_to_array(self._faiss.id_map), dtype=np.int64)

    def differing(self, entries: Sequence[IndexEntry], vectors: Array) -> list[int]:
        """See PlaceIndex."""
        flat: Any = faiss.downcast_index(self._faiss.index)
        stored = faiss.rev_swig_ptr(flat.get_xb(), flat.ntotal * self._dimension).reshape(-1, self._dimension)
        return _differing(self._metadata, entries, vectors, self.ids(), stored)

    def _search(self, query: Array, k: int, allowed: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
        parameters = None
        if len(allowed) < len(self._metadata.rows):
            parameters = faiss.SearchParameters()
            parameters.sel = faiss.IDSelectorBatch(allowed)
        similarities, ids = self._faiss.search(query[None], k, params=parameters)
        return similarities[0], ids[0]


def _differing(
    metadata: _Metadata, entries: Sequence[IndexEntry], vectors: Array, ids: NDArray[np.int64], stored: Array
) -> list[int]:
    """The ids of `entries` whose metadata or vectors are others in the index, `stored` in the order of `ids`."""
    matrix = np.ascontiguousarray(vectors, dtype=np.float32)
    if matrix.shape != (len(entries), stored.shape[1]):
        raise BadField(f"vectors must be ({len(entries)}, {stored.shape[1]}), got {matrix.shape}", field="vectors")
    expected = _normalised(matrix, "vectors").view(np.uint32)
    # The last row counts where an id occurs twice: an id that was removed and added again.
    wanted = np.flatnonzero(np.isin(ids, np.array([entry.id for entry in entries], dtype=np.int64)))
    rows = dict(zip(ids[wanted].tolist(), wanted.tolist(), strict=True))
    return [
        entry.id
        for entry, vector in zip(entries, expected, strict=True)
        if entry.id not in rows
        or not metadata.holds(entry)
        or not np.array_equal(stored[rows[entry.id]].view(np.uint32), vector)
    ]


def _ranked(ids: NDArray[np.int64], similarities: Array, k: int) -> list[Match]:
    if len(ids) > 4 * k:
        kth = np.partition(similarities, len(ids) - k)[len(ids) - k]
        ids, similarities = ids[similarities >= kth], similarities[similarities >= kth]
    order = np.lexsort((ids, -similarities))[:k]
    return [Match(int(ids[row]), float(similarities[row])) for row in order]


def checked_vectors(entries: Sequence[IndexEntry], vectors: Array, dimension: int, stored: Container[int]) -> Array:
    """The vectors (n, d) as `PlaceIndex.add` stores them; `stored` ids are refused. Raises BadField."""
    matrix = np.ascontiguousarray(vectors, dtype=np.float32)
    if matrix.shape != (len(entries), dimension):
        raise BadField(f"vectors must be ({len(entries)}, {dimension}), got {matrix.shape}", field="vectors")
    ids = [entry.id for entry in entries]
    if len(set(ids)) != len(ids) or any(identifier in stored for identifier in ids):
        raise BadField("an id is stored already", field="id")
    return _normalised(matrix, "vectors")


def checked_vector(vector: Array, dimension: int) -> Array:
    """The vector (d,) of a query, L2-normalised. Raises BadField where it cannot be searched for."""
    query = np.ascontiguousarray(vector, dtype=np.float32)
    if query.shape != (dimension,):
        raise BadField(f"the vector must be ({dimension},), got {query.shape}", field="vector")
    return np.asarray(_normalised(query[None], "vector")[0])


def _checked_query(vector: Array, k: int, dimension: int) -> tuple[Array, int]:
    query = checked_vector(vector, dimension)
    if k < 1:
        raise BadField(f"k must be at least 1, got {k}", field="k")
    return query, min(k, MAX_K)


def _normalised(matrix: Array, field: str) -> Array:
    if not np.isfinite(matrix).all():
        raise BadField("a descriptor holds NaN or infinity", field=field)
    lengths = np.linalg.norm(matrix, axis=1, keepdims=True)
    if (lengths < 1e-6).any():
        raise BadField("a descriptor is zero", field=field)
    return np.asarray(matrix / lengths, dtype=np.float32)
