"""Which submaps of two maps may show the same place: the likest of each in the other, whichever map asks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import AdaptationConfig
from revisit.core.descriptor.adaptation import SessionSums, by_session, learn_site

Array = NDArray[np.float32]

_ROWS = 2048


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

    Both are standardised by what they have in common (docs/decisions/0120), as one map of both would be. A pair is
    there whichever of the maps asks for it. `storeys` (n,), (m,) are numbers, -1 where unknown: places on different
    ones are no pair, and take no other's place.
    """
    if not len(first) or not len(second):
        return Candidates(np.zeros((0, 2), np.int64), np.zeros(0, np.float32))
    adapted = _standardised(np.concatenate([first, second]), np.concatenate(sessions))
    alike = _products(adapted[: len(first)], adapted[len(first) :])
    if storeys is not None:
        one, other = storeys[0][:, None], storeys[1]
        alike[(one != other) & (one >= 0) & (other >= 0)] = -np.inf
    chosen = np.zeros(alike.shape, dtype=bool)
    for axis in (0, 1):
        count = min(k, alike.shape[axis])
        likest = np.argpartition(-alike, count - 1, axis=axis).take(range(count), axis=axis)
        np.put_along_axis(chosen, likest, True, axis=axis)
    rows, columns = np.nonzero(chosen & np.isfinite(alike))
    order = np.lexsort((columns, rows, -alike[rows, columns]))
    pairs = np.column_stack([rows, columns])[order]
    return Candidates(pairs.astype(np.int64), alike[rows, columns][order])


def _standardised(vectors: Array, sessions: NDArray[np.int64], config: AdaptationConfig = AdaptationConfig()) -> Array:
    if len(vectors) < config.first_places:
        return vectors
    sums = {session: SessionSums.of(vectors[rows]) for session, rows in by_session(sessions)}
    return learn_site(sums, config).with_sessions(sums).adapted(vectors, sessions)


def _products(first: Array, second: Array) -> Array:
    """Scalar products (n, m) of rows, some rows at a time."""
    parts = [first[start : start + _ROWS] @ second.T for start in range(0, len(first), _ROWS)]
    return np.concatenate(parts).astype(np.float32)
