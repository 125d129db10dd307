"""Cosines of descriptors standardised by their map, without an array of the standardised ones (docs/decisions/0221)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inner_sums, loop

Array = NDArray[np.float32]


def adapted_cosines(
    vectors: Array, means: Array, which: NDArray[np.int64], spread: Array, query: Array, shortest: float
) -> Array:
    """The cosine (n,) of a unit `query` (d,) with each of `vectors` (n, d), relative to the mean `means[which]` of its
    session and divided by `spread` (d,), which is as long as one. What is no longer than `shortest` then is compared as
    it is.
    """
    found = np.empty(len(vectors), dtype=np.float32)
    _compare(vectors, means, which, np.float32(1.0) / spread, query, np.float32(shortest * shortest), found)
    return found


def warm_up() -> None:
    """Compare a descriptor, for the compiler's sake alone."""
    one = np.ones((1, 2), dtype=np.float32)
    adapted_cosines(one, one, np.zeros(1, np.int64), one[0], one[0], 1e-6)


@loop
def _compare(
    vectors: Array, means: Array, which: NDArray[np.int64], inverse: Array, query: Array, shortest: np.float32,
    found: Array,
) -> None:  # fmt: skip
    """Fill `found` (n,) with the cosines, row by row: none depends on which rows are compared together."""
    for i in range(len(vectors)):
        along, squared = _sums(vectors[i], means[which[i]], inverse, query)
        found[i] = along / np.sqrt(squared) if squared > shortest else _product(vectors[i], query)


@inner_sums
def _sums(vector: Array, mean: Array, inverse: Array, query: Array) -> tuple[np.float32, np.float32]:
    """Of the standardised vector: its product with the query, and its square."""
    along, squared = np.float32(0.0), np.float32(0.0)
    for j in range(len(vector)):
        entry = (vector[j] - mean[j]) * inverse[j]
        along += entry * query[j]
        squared += entry * entry
    return along, squared


@inner_sums
def _product(vector: Array, query: Array) -> np.float32:
    along = np.float32(0.0)
    for j in range(len(vector)):
        along += vector[j] * query[j]
    return along
