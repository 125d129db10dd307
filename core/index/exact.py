"""The reference: every search learns from all entries and compares with all that pass the filter."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import AdaptationConfig
from revisit.core.descriptor.adaptation import SiteStatistics
from revisit.core.index.entries import Array, IndexEntry, Match, SearchFilter, checked_query, checked_vectors, ranked
from revisit.core.index.learning import learn_plainly
from revisit.core.index.rows import Rows

_PORTION = 2048
"""Rows compared at a time, so that a search takes little memory."""


class ExactIndex:
    """A `PlaceIndex` as plain as its definition. Its statistics are kept until its entries change."""

    def __init__(self, dimension: int, config: AdaptationConfig = AdaptationConfig()) -> None:
        self._config = config
        self._rows = Rows(dimension)
        self._known: tuple[int, int] | None = None
        self._site: SiteStatistics | None = None

    def __len__(self) -> int:
        return len(self._rows.row_of)

    def add(self, entries: Sequence[IndexEntry], vectors: Array, *, more: bool = False) -> None:
        """See PlaceIndex."""
        rows = self._rows
        rows.append(entries, checked_vectors(entries, vectors, rows.vectors.dimension, rows.row_of))

    def remove(self, ids: Sequence[int]) -> None:
        """See PlaceIndex."""
        if len(self._rows.drop(ids)):
            self._known = None
            self._rows.compact()

    def search(self, vector: Array, k: int, only: SearchFilter = SearchFilter()) -> list[Match]:
        """See PlaceIndex."""
        query, k = checked_query(vector, k, self._rows.vectors.dimension)
        rows = np.flatnonzero(self._rows.passing(only))
        return ranked(self._rows.ids[rows], similarities(self._rows, rows, self._learned(), query, only), k)

    def count_of(self, sessions: Collection[int]) -> int:
        """See PlaceIndex."""
        return self._rows.count_of(sessions)

    def ids_of(self, sessions: Collection[int]) -> NDArray[np.int64]:
        """See PlaceIndex."""
        return self._rows.ids_of(sessions)

    def ids(self) -> NDArray[np.int64]:
        """See PlaceIndex."""
        return self._rows.ids[self._rows.live()]

    def differing(self, entries: Sequence[IndexEntry], vectors: Array) -> list[int]:
        """See PlaceIndex."""
        return self._rows.differing(entries, vectors)

    def _learned(self) -> SiteStatistics | None:
        if self._known != (self._rows.count, len(self)):
            self._site = learn_plainly(self._rows, self._config)
            self._known = self._rows.count, len(self)
        return self._site


def similarities(
    rows: Rows, chosen: NDArray[np.intp], site: SiteStatistics | None, query: Array, only: SearchFilter
) -> Array:
    """The cosine of a unit query (d,) with each of the `chosen` rows (n,), standardised by `site`.

    One by one: the bits do not depend on which rows are compared together.
    """
    wanted = asked(site, query, only)
    found = np.empty(len(chosen), dtype=np.float32)
    for start in range(0, len(chosen), _PORTION):
        part = chosen[start : start + _PORTION]
        vectors = rows.descriptors(part)
        found[start : start + _PORTION] = (
            np.einsum("ij,j->i", vectors, wanted)
            if site is None
            else site.cosines(vectors, rows.sessions[part], wanted)
        )
    return found


def standardised(rows: Rows, chosen: NDArray[np.intp], site: SiteStatistics | None) -> Array:
    """The `chosen` rows (n,) as they are compared: unit vectors (n, d)."""
    vectors = rows.descriptors(chosen)
    return vectors if site is None else site.adapted(vectors, rows.sessions[chosen])


def asked(site: SiteStatistics | None, query: Array, only: SearchFilter) -> Array:
    """The query (d,) as it is compared: relative to the mean of the session that the filter names, else the map's."""
    session = -1 if only.of_session is None else only.of_session
    return query if site is None else site.adapted(query[None], np.array([session]))[0]
