"""The descriptors of an index, a row each: the first ones may be shared with other processes, the rest are its own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from revisit.core.index.entries import Array

Indices = NDArray[np.intp]
Marks = NDArray[np.uint64]

PORTION = 256
"""Rows that are copied at a time: a megabyte."""

_COPIED_BELOW = 4096
"""Rows that are copied to be in one block with those that come; that takes 10 ms at most."""

_OF_ID = np.uint64(0x9E3779B97F4A7C15)


class RowDiffers(Exception):
    """A shared row has changed: it was erased, or is damaged. Nothing may be answered from it."""


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
    """Growing rows of descriptors (n, d). Shared rows are read-only and checked at every read."""

    def __init__(self, dimension: int, shared: SharedRows | None = None) -> None:
        self.dimension = dimension
        self._shared = shared
        self._blocks: tuple[Array, ...] = ()  # its own, each as large as all before it

    def __len__(self) -> int:
        """How many rows there is room for."""
        return self.shared_count + sum(map(len, self._blocks))

    def __getitem__(self, rows: Indices | Sequence[int]) -> Array:
        """A copy of those rows. Raises RowDiffers."""
        asked = np.asarray(rows, dtype=np.intp)
        if self._shared is None and len(self._blocks) == 1:
            return self._blocks[0][asked]
        is_shared = asked < self.shared_count
        if self._shared is not None and is_shared.all():
            return self._shared.taken(asked)
        found = np.empty((len(asked), self.dimension), dtype=np.float32)
        if self._shared is not None and is_shared.any():
            found[is_shared] = self._shared.taken(asked[is_shared])
        for start, block in self._own():
            in_block = np.flatnonzero((asked >= start) & (asked < start + len(block)))
            found[in_block] = block[asked[in_block] - start]
        return found

    @property
    def shared_count(self) -> int:
        """How many of the first rows are shared."""
        return 0 if self._shared is None else len(self._shared.vectors)

    def as_held(self, row: int) -> Array:
        """One row (d,) as it is, checked or not: for comparing."""
        if self._shared is not None and row < self.shared_count:
            return np.asarray(self._shared.vectors[row])
        return next(block[row - start] for start, block in self._own() if row < start + len(block))

    def put(self, first: int, vectors: Array) -> None:
        """Write rows from `first` on, all behind the shared ones; there must be room."""
        end = first + len(vectors)
        for start, block in self._own():
            begin, stop = max(first, start), min(end, start + len(block))
            if begin < stop:
                block[begin - start : stop - start] = vectors[begin - first : stop - first]

    def reserve(self, size: int) -> None:
        """Make room for `size` rows in all, more than there is; it takes no memory before they are written to."""
        kept = self._blocks if len(self) - self.shared_count >= _COPIED_BELOW else ()
        start = self.shared_count + sum(map(len, kept))
        block: Array = np.empty((size - start, self.dimension), dtype=np.float32)
        for small in self._blocks[len(kept) :]:  # one at most
            block[: len(small)] = small
        self._blocks = (*kept, block)

    def only(self, rows: Indices) -> Descriptors:
        """The shared rows, with which `rows` begin, and of this process's own the others of `rows`."""
        kept = Descriptors(self.dimension, self._shared)
        kept._blocks = (self[rows[self.shared_count :]],)
        return kept

    def frozen(self) -> Descriptors:
        """The same rows; later changes do not touch them."""
        same = Descriptors(self.dimension, self._shared)
        same._blocks = self._blocks
        return same

    def _own(self) -> Iterator[tuple[int, Array]]:
        """The blocks of this process's own rows, and the first row of each."""
        start = self.shared_count
        for block in self._blocks:
            yield start, block
            start += len(block)


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
