"""The records, queries and contract of the place index (paper III-E, Eq. 15)."""

from __future__ import annotations

from collections.abc import Collection, Container, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField

Array = NDArray[np.float32]
Flags = NDArray[np.bool_]

MAX_K = 1000


@dataclass(frozen=True)
class IndexEntry:
    """A stored entry for filters: its id, session, ordinal in the session and position (3,) metres."""

    id: int
    session: int
    ordinal: int
    position: NDArray[np.float64]


@dataclass(frozen=True)
class SearchFilter:
    """Which entries may be found; every condition that is given must hold.

    only_sessions: entries of these sessions alone. of_session: that of the query, which decides how its descriptor is
    standardised and leaves out no entry. position (3,) and radius_m: only entries at most that far away. without: none
    of these ids. allowed: only these ids.
    """

    exclude_session: int | None = None
    only_session: int | None = None
    only_sessions: frozenset[int] | None = None
    of_session: int | None = None
    position: NDArray[np.float64] | None = None
    radius_m: float | None = None
    without: frozenset[int] = frozenset()
    allowed: frozenset[int] | None = None


@dataclass(frozen=True)
class Match:
    """A found entry and its cosine similarity."""

    id: int
    similarity: float


class PlaceIndex(Protocol):
    """Descriptors of entries with their metadata; similarities are cosines of descriptors standardised by the map.

    How they are standardised is in `core.descriptor.adaptation` (docs/decisions/0120): what is answered depends only on
    the entries that are held and on the order in which they came. A query takes the mean of the session that
    `SearchFilter.of_session` names, else the map's.
    """

    def add(self, entries: Sequence[IndexEntry], vectors: Array, *, more: bool = False) -> None:
        """Store vectors (n, d), which are L2-normalised. `more` are added at once: it may wait for them to get fast.

        Raises BadField for another length, NaN, infinity, a zero vector or an id that is stored already or twice in
        `entries`; then nothing is stored.
        """

    def remove(self, ids: Sequence[int]) -> None:
        """Forget entries; unknown ids are ignored."""

    def search(self, vector: Array, k: int, only: SearchFilter = ...) -> list[Match]:
        """At most min(k, 1000) entries by falling similarity, ties by id. k < 1 or an unusable vector: BadField."""

    def __len__(self) -> int:
        """How many entries are stored."""

    def count_of(self, sessions: Collection[int]) -> int:
        """How many of them are of these sessions."""

    def ids_of(self, sessions: Collection[int]) -> NDArray[np.int64]:
        """The ids of the entries of these sessions."""

    def ids(self) -> NDArray[np.int64]:
        """The ids of the entries that a search compares with."""

    def differing(self, entries: Sequence[IndexEntry], vectors: Array) -> list[int]:
        """The ids of those `entries` that are not stored as `add` would store them, bit for bit. Raises BadField."""


def ranked(ids: NDArray[np.int64], similarities: Array, k: int) -> list[Match]:
    """The k best of the entries `ids` (n,) with `similarities` (n,), ties by id."""
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


def _checked_vector(vector: Array, dimension: int) -> Array:
    """The vector (d,) of a query, L2-normalised. Raises BadField where it cannot be searched for."""
    query = np.ascontiguousarray(vector, dtype=np.float32)
    if query.shape != (dimension,):
        raise BadField(f"the vector must be ({dimension},), got {query.shape}", field="vector")
    return np.asarray(_normalised(query[None], "vector")[0])


def checked_query(vector: Array, k: int, dimension: int) -> tuple[Array, int]:
    """The vector (d,) L2-normalised and at most `MAX_K` of the k answers asked for. Raises BadField."""
    query = _checked_vector(vector, dimension)
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
