"""The descriptors of an index, a row each: the first ones may be shared with other processes, the rest are its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from revisit.core.index.places import Array

Indices = NDArray[np.intp]
Marks = NDArray[np.uint64]

PORTION = 256
"""Rows that are copied at a time: a megabyte."""

_OF_ID = np.uint64(0x9E3779B97F4A7C15)


class RowDiffers(Exception):
    """A shared row is not what it was: it was erased since, or is damaged. Nothing may be answered from it."""


@dataclass(frozen=True)
class SharedRows:
    """Descriptors (n, d) that others may hold, too, and erase; d is even. `marks` (n,) tell when a row was changed."""

    ids: NDArray[np.int64]
    vectors: Array
    marks: Marks

    def taken(self, rows: Indices) -> Array:
        """A copy of those rows. Raises RowDiffers."""
        vectors = np.take(self.vectors, rows, axis=0)
        if (marks_of(self.ids[rows], vectors) != self.marks[rows]).any():
            raise RowDiffers
        return vectors


class Descriptors:
    """Growing rows of descriptors (n, d). What is shared is read-only and checked whenever it is read."""

    def __init__(self, dimension: int, shared: SharedRows | None = None) -> None:
        self.dimension = dimension
        self.own: Array = np.zeros((0, dimension), dtype=np.float32)
        self._shared = shared

    def __len__(self) -> int:
        """How many rows there is room for."""
        return self.shared_count + len(self.own)

    def __getitem__(self, rows: Indices | Sequence[int]) -> Array:
        """A copy of those rows. Raises RowDiffers."""
        asked = np.asarray(rows, dtype=np.intp)
        if self._shared is None:
            return self.own[asked]
        is_own = asked >= self.shared_count
        if not is_own.any():
            return self._shared.taken(asked)
        found = np.empty((len(asked), self.dimension), dtype=np.float32)
        found[is_own] = self.own[asked[is_own] - self.shared_count]
        found[~is_own] = self._shared.taken(asked[~is_own])
        return found

    @property
    def shared_count(self) -> int:
        """How many of the first rows are shared."""
        return 0 if self._shared is None else len(self._shared.vectors)

    def as_held(self, row: int) -> Array:
        """One row (d,) as it is, checked or not: for comparing."""
        if self._shared is not None and row < self.shared_count:
            return np.asarray(self._shared.vectors[row])
        return np.asarray(self.own[row - self.shared_count])

    def put(self, start: int, vectors: Array) -> None:
        """Write rows from `start` on, all behind the shared ones; there must be room."""
        first = start - self.shared_count
        self.own[first : first + len(vectors)] = vectors

    def reserve(self, size: int) -> None:
        """Make room for `size` rows in all; zeros take no memory before they are written to."""
        larger = np.zeros((size - self.shared_count, self.dimension), dtype=np.float32)
        larger[: len(self.own)] = self.own
        self.own = larger

    def only(self, rows: Indices) -> Descriptors:
        """The shared rows, with which `rows` begin, and of this process's own the others of `rows`."""
        kept = Descriptors(self.dimension, self._shared)
        kept.own = self.own[rows[self.shared_count :] - self.shared_count]
        return kept

    def frozen(self) -> Descriptors:
        """The same rows; what is put or removed later does not change them."""
        same = Descriptors(self.dimension, self._shared)
        same.own = self.own
        return same


def marks_of(ids: NDArray[np.int64], vectors: Array) -> Marks:
    """A number for each row (n, d) and its id (n,): another one after any change of a bit. Not against an enemy.

    A sum of the row's words, each times an odd number of its own: no change of one word leaves it as it is, and one of
    several words hardly ever.
    """
    words = np.ascontiguousarray(vectors).view(np.uint64)
    summed: Marks = np.einsum("ij,j->i", words, _weights(words.shape[1]))
    return summed + (ids.astype(np.uint64) + np.uint64(1)) * _OF_ID


@cache
def _weights(count: int) -> Marks:
    return np.random.default_rng(202).integers(0, 2**63, count, dtype=np.uint64) * np.uint64(2) + np.uint64(1)
