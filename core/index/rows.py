"""The descriptors that an index holds, in order of arrival, with the filter fields of their entries."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from revisit.core.index.descriptors import Descriptors, Indices, SharedRows
from revisit.core.index.entries import Array, Flags, IndexEntry, SearchFilter, checked_vectors

SMALLEST_TO_COMPACT = 64
"""Fewer rows than this are not worth copying."""


class Rows:
    """Growing arrays, one row an entry; the row of a removed entry stays until most rows are of removed ones.

    Shared rows stay as they are: copying them would take more than it gives back (docs/decisions/0305).
    """

    def __init__(self, dimension: int) -> None:
        self.row_of: dict[int, int] = {}
        self.count = 0
        self.ids = np.zeros(0, dtype=np.int64)
        self.sessions = np.zeros(0, dtype=np.int64)
        self.ordinals = np.zeros(0, dtype=np.int64)
        self.positions = np.zeros((0, 3))
        self.alive = np.zeros(0, dtype=bool)
        self.vectors = Descriptors(dimension)

    @classmethod
    def restored(
        cls,
        shared: SharedRows,
        sessions: NDArray[np.int64],
        ordinals: NDArray[np.int64],
        positions: NDArray[np.float64],
    ) -> Rows:
        """Rows whose descriptors are shared, with their filter fields (n,), positions (n, 3)."""
        rows = cls(shared.vectors.shape[1])
        rows.ids, rows.sessions, rows.ordinals, rows.positions = shared.ids, sessions, ordinals, positions
        rows.alive, rows.count = np.ones(len(shared.ids), dtype=bool), len(shared.ids)
        rows.vectors = Descriptors(shared.vectors.shape[1], shared)
        rows.row_of = {identifier: row for row, identifier in enumerate(rows.ids.tolist())}
        return rows

    def append(self, entries: Sequence[IndexEntry], vectors: Array) -> None:
        """Add entries whose ids are new, with vectors (n, d) that were checked."""
        start, end = self.count, self.count + len(entries)
        self._reserve(end)
        self.vectors.put(start, vectors)
        for row, entry in enumerate(entries, start):
            self.row_of[entry.id] = row
            self.ids[row], self.sessions[row], self.ordinals[row] = entry.id, entry.session, entry.ordinal
            self.positions[row] = entry.position
        self.alive[start:end] = True
        self.count = end

    def drop(self, ids: Sequence[int]) -> Indices:
        """Mark entries as removed; their rows."""
        known = [identifier for identifier in dict.fromkeys(ids) if identifier in self.row_of]
        gone = np.array([self.row_of.pop(identifier) for identifier in known], dtype=np.intp)
        self.alive[gone] = False
        return gone

    def compact(self) -> Indices | None:
        """Give the rows of removed entries back once they are most of this process's own; the shared ones stay.

        Where rows have new numbers now: the row that each had before.
        """
        first = self.vectors.shared_count
        own = self.alive[first : self.count]
        if len(own) < SMALLEST_TO_COMPACT or 2 * np.count_nonzero(own) > len(own):
            return None
        kept = np.concatenate([np.arange(first), first + np.flatnonzero(own)])
        self.ids, self.sessions, self.ordinals = self.ids[kept], self.sessions[kept], self.ordinals[kept]
        self.positions, self.alive, self.vectors = self.positions[kept], self.alive[kept], self.vectors.only(kept)
        self.count, live = len(kept), np.flatnonzero(self.alive)
        self.row_of = dict(zip(self.ids[live].tolist(), live.tolist(), strict=True))
        return kept

    def live(self) -> NDArray[np.intp]:
        """The rows of entries that were not removed, in order."""
        return np.flatnonzero(self.alive[: self.count])

    def descriptors(self, chosen: Indices) -> Array:
        """The descriptors of those rows; zeros for removed entries. Raises RowDiffers."""
        lives = self.alive[chosen]
        if lives.all():
            return self.vectors[chosen]
        found = np.zeros((len(chosen), self.vectors.dimension), dtype=np.float32)
        found[lives] = self.vectors[chosen[lives]]
        return found

    def shared_of(self, ids: Sequence[int]) -> Indices:
        """The rows of those ids whose descriptors are shared."""
        rows = np.array([self.row_of[identifier] for identifier in ids if identifier in self.row_of], np.intp)
        return rows[rows < self.vectors.shared_count]

    def passing(self, only: SearchFilter) -> Flags:
        """Which rows (count,) a search may find."""
        sessions = self.sessions[: self.count]
        passes = self.alive[: self.count].copy()
        if only.exclude_session is not None:
            passes &= sessions != only.exclude_session
        if only.only_session is not None:
            passes &= sessions == only.only_session
        if only.only_sessions is not None:
            passes &= self._are_of(only.only_sessions)
        left_out = [self.row_of[identifier] for identifier in only.without if identifier in self.row_of]
        passes[np.array(left_out, dtype=np.intp)] = False
        if only.position is not None and only.radius_m is not None:
            distances = np.linalg.norm(self.positions[: self.count] - only.position, axis=1)
            passes &= distances <= only.radius_m
        if only.allowed is not None:
            passes &= np.isin(self.ids[: self.count], np.fromiter(only.allowed, np.int64, len(only.allowed)))
        return passes

    def count_of(self, sessions: Collection[int]) -> int:
        """How many entries are of these sessions."""
        return int(np.count_nonzero(self.alive[: self.count] & self._are_of(sessions)))

    def ids_of(self, sessions: Collection[int]) -> NDArray[np.int64]:
        """The ids of the entries of these sessions."""
        return self.ids[np.flatnonzero(self.alive[: self.count] & self._are_of(sessions))]

    def _are_of(self, sessions: Collection[int]) -> Flags:
        """Which rows (count,) are of these sessions."""
        return np.isin(self.sessions[: self.count], np.fromiter(sessions, np.int64, len(sessions)))

    def differing(self, entries: Sequence[IndexEntry], vectors: Array) -> list[int]:
        """See PlaceIndex."""
        expected = checked_vectors(entries, vectors, self.vectors.dimension, {})
        return [entry.id for entry, vector in zip(entries, expected, strict=True) if not self._holds(entry, vector)]

    def _holds(self, entry: IndexEntry, vector: Array) -> bool:
        row = self.row_of.get(entry.id)
        return row is not None and bool(
            self.alive[row]
            and (self.ids[row], self.sessions[row], self.ordinals[row]) == (entry.id, entry.session, entry.ordinal)
            and np.array_equal(self.positions[row], entry.position)
            and self.vectors.as_held(row).tobytes() == vector.tobytes()
        )

    def _reserve(self, wanted: int) -> None:
        if wanted <= len(self.ids):
            return
        shared = self.vectors.shared_count
        size = shared + max(wanted - shared, 2 * (len(self.ids) - shared), SMALLEST_TO_COMPACT)
        self.vectors.reserve(size)
        for name in ("ids", "sessions", "ordinals", "positions", "alive"):
            setattr(self, name, _enlarged(getattr(self, name), size))


def _enlarged(array: NDArray[np.generic], size: int) -> NDArray[np.generic]:
    """The array with zeros behind it, `size` rows in all; zeros take no memory before they are written to."""
    larger = np.zeros((size, *array.shape[1:]), dtype=array.dtype)
    larger[: len(array)] = array
    return larger
