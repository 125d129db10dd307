"""Which submaps of two maps may show the same place: the likest of each in the other, whichever map asks."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import AdaptationConfig
from revisit.core.descriptor.adaptation import SessionSums, by_session, learn_site

Array = NDArray[np.float32]

_CELLS = 1 << 22
"""Cosines, at most, that are computed at once: 16 MiB, and twice that for their order."""


@dataclass(frozen=True)
class Candidates:
    """Pairs (m, 2) of rows of two maps, and how alike the two of each are (m,): cosines, the likest first."""

    pairs: NDArray[np.int64]
    similarities: Array


def joining_candidates(
    first: Array,
    second: Array,
    sessions: tuple[NDArray[np.int64], NDArray[np.int64]],
    k: int,
    storeys: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None,
) -> Candidates:
    """The `k` likest of the other map for every place of either, descriptors (n, d) and (m, d) of `sessions`.

    Both are standardised by common statistics (docs/decisions/0120), as one map of both would be. A pair is
    there whichever of the maps asks for it. `storeys` (n,), (m,) are numbers, -1 where unknown: places on different
    ones are no pair, and take no other's place.
    """
    if not len(first) or not len(second):
        return Candidates(np.zeros((0, 2), np.int64), np.zeros(0, np.float32))
    adapted = _standardised(np.concatenate([first, second]), np.concatenate(sessions))
    ours, theirs = np.split(adapted, [len(first)])
    entries = _likest(ours, theirs, storeys, k)
    pairs, at = np.unique(np.column_stack([entries.rows, entries.columns]), axis=0, return_index=True)
    cosines = entries.cosines[at]
    order = np.lexsort((pairs[:, 1], pairs[:, 0], -cosines))
    order = order[np.isfinite(cosines[order])]
    return Candidates(pairs[order].astype(np.int64), cosines[order])


def _standardised(vectors: Array, sessions: NDArray[np.int64], config: AdaptationConfig = AdaptationConfig()) -> Array:
    if len(vectors) < config.first_places:
        return vectors
    sums = {session: SessionSums.of(vectors[rows]) for session, rows in by_session(sessions)}
    return learn_site(sums, config).with_sessions(sums).adapted(vectors, sessions)


@dataclass(frozen=True)
class _Entries:
    """Some cells of the table of all cosines: rows, columns and cosines, all of one shape."""

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    cosines: Array

    def likest(self, k: int, axis: int) -> _Entries:
        """The `k` likest along an axis, or all where there are fewer."""
        count = min(k, self.cosines.shape[axis])
        chosen = np.argpartition(-self.cosines, count - 1, axis=axis).take(range(count), axis=axis)
        rows, columns = (np.take_along_axis(one, chosen, axis) for one in (self.rows, self.columns))
        return _Entries(rows, columns, np.take_along_axis(self.cosines, chosen, axis))

    def joined(self, other: _Entries) -> _Entries:
        """These rows of cells, and others below them."""
        rows, columns = np.concatenate((self.rows, other.rows)), np.concatenate((self.columns, other.columns))
        return _Entries(rows, columns, np.concatenate((self.cosines, other.cosines)))

    def in_a_row(self) -> _Entries:
        """The same, (n,)."""
        return _Entries(self.rows.ravel(), self.columns.ravel(), self.cosines.ravel())


def _likest(
    first: Array, second: Array, storeys: tuple[NDArray[np.int64], NDArray[np.int64]] | None, k: int
) -> _Entries:
    """The `k` likest of each row and column of the table of all cosines, of which some rows are there at once."""
    at_once = max(1, _CELLS // len(second))
    of_rows: list[_Entries] = []
    of_columns: _Entries | None = None
    for start in range(0, len(first), at_once):
        some = slice(start, start + at_once)
        block = _block(first[some], second, start, None if storeys is None else (storeys[0][some], storeys[1]))
        of_rows.append(block.likest(k, axis=1).in_a_row())
        likest = block.likest(k, axis=0)
        of_columns = likest if of_columns is None else of_columns.joined(likest).likest(k, axis=0)
    found = of_rows if of_columns is None else [*of_rows, of_columns.in_a_row()]
    return functools.reduce(_Entries.joined, found)


def _block(
    first: Array, second: Array, start: int, storeys: tuple[NDArray[np.int64], NDArray[np.int64]] | None
) -> _Entries:
    """All cells of some rows of the table, the first of which is `start`; places on different storeys are not alike."""
    cosines = (first @ second.T).astype(np.float32, copy=False)
    if storeys is not None:
        one, other = storeys[0][:, None], storeys[1]
        cosines[(one != other) & (one >= 0) & (other >= 0)] = -np.inf
    rows, columns = np.arange(start, start + len(first))[:, None], np.arange(len(second))
    return _Entries(np.broadcast_to(rows, cosines.shape), np.broadcast_to(columns, cosines.shape), cosines)
