"""The index of the service: FAISS proposes rows, an exact cosine ranks them (paper III-E, Eq. 15)."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import faiss
import numpy as np
from numpy.typing import NDArray

from revisit.core.config import AdaptationConfig
from revisit.core.index.descriptors import PORTION, Descriptors, Marks, SharedRows, marks_of
from revisit.core.index.entries import (
    Array,
    Flags,
    IndexEntry,
    Match,
    SearchFilter,
    checked_query,
    checked_vectors,
    ranked,
)
from revisit.core.index.exact import asked, similarities, standardised
from revisit.core.index.learning import SiteLearner
from revisit.core.index.rows import Rows
from revisit.core.index.shortlist import CodedShortlist, FlatShortlist

Indices = NDArray[np.intp]

CODED_FROM = 4096
"""Entries from which a map is searched by codes: below, comparing with all takes about a millisecond."""
_CODES_ARE_LEARNED_ANEW_AFTER = 4
_SHORTLIST = 160
_PLACES_PER_PROPOSED = 3000
"""Of more than 480,000 entries more are proposed than `_SHORTLIST`: one for so many (docs/decisions/0112)."""
_FEW = 2048
_CODED_PER_SEARCH = 256


@dataclass(frozen=True)
class StoredIndex:
    """An index as arrays by name, and its descriptors, which are `rows` of `vectors`: nothing changes them any more.

    `known` are the arrays without the codes, and `codes` those of all rows.
    """

    known: Mapping[str, NDArray[np.generic]]
    vectors: Descriptors
    rows: Indices
    codes: CodedShortlist | None

    @cached_property
    def arrays(self) -> Mapping[str, NDArray[np.generic]]:
        """All arrays. Taking removed entries out of the codes takes long, so it is done here, where no search waits."""
        if self.codes is None:
            return self.known
        self.codes.keep(self.rows)
        return {**self.known, **self.codes.stored()}

    @property
    def size_bytes(self) -> int:
        """Its size in bytes."""
        return sum(array.nbytes for array in self.arrays.values()) + 4 * self.vectors.dimension * len(self.rows)

    def portions(self) -> Iterator[tuple[Array, Marks]]:
        """The descriptors (n, d) in order, a few at a time, and their marks (n,). Raises RowDiffers."""
        ids = np.asarray(self.arrays["ids"], dtype=np.int64)
        for start in range(0, len(ids), PORTION):
            portion = self.vectors[self.rows[start : start + PORTION]]
            yield portion, marks_of(ids[start : start + PORTION], portion)


class FaissIndex:
    """A `PlaceIndex` with 4 to 6 kB a place of 1,024 entries, and a search that hardly grows with the map.

    Up to `coded_from` entries it is exact. Above, the best are those of a few hundred that their codes propose. The
    codes are made along with the entries that come and the searches that ask, a few at a time; until they are ready,
    all entries are compared.
    """

    def __init__(
        self, dimension: int, config: AdaptationConfig = AdaptationConfig(), coded_from: int = CODED_FROM
    ) -> None:
        faiss.omp_set_num_threads(1)  # parallelism is by processes
        self._coded_from = coded_from
        self._rows = Rows(dimension)
        self._learner = SiteLearner(config)
        self._flat: FlatShortlist | None = FlatShortlist(dimension)
        self._codes: CodedShortlist | None = None
        self._next_codes: CodedShortlist | None = None
        self._waiting = 0  # entries that were added while more were to come: no codes were made along with them

    def __len__(self) -> int:
        return len(self._rows.row_of)

    def add(self, entries: Sequence[IndexEntry], vectors: Array, *, more: bool = False) -> None:
        """See PlaceIndex."""
        self._rows.append(entries, checked_vectors(entries, vectors, self._dimension, self._rows.row_of))
        if self._codes is not None:
            self._codes.append(self._rows, self._rows.count)
        self._waiting += len(entries)
        if not more:
            self._prepare_codes(_CODES_ARE_LEARNED_ANEW_AFTER * self._waiting)
            self._waiting = 0

    def remove(self, ids: Sequence[int]) -> None:
        """See PlaceIndex."""
        gone = self._rows.drop(ids)
        if len(gone):
            self._learner.forget(self._rows, gone)
            self._flat = FlatShortlist(self._dimension) if self._flat is not None else None
            if (kept := self._rows.compact()) is not None:
                self._renumber(kept)

    def search(self, vector: Array, k: int, only: SearchFilter = SearchFilter()) -> list[Match]:
        """See PlaceIndex."""
        query, k = checked_query(vector, k, self._dimension)
        self._prepare_codes(_CODED_PER_SEARCH)
        self._learn()
        passing = self._rows.passing(only)
        rows = self._shortlisted(query, k, only, passing) if passing.any() else np.zeros(0, np.intp)
        return ranked(self._rows.ids[rows], similarities(self._rows, rows, self._learner.site, query, only), k)

    def count_of(self, sessions: Collection[int]) -> int:
        """See PlaceIndex."""
        return self._rows.count_of(sessions)

    def ids_of(self, sessions: Collection[int]) -> NDArray[np.int64]:
        """See PlaceIndex."""
        return self._rows.ids_of(sessions)

    def ids(self) -> NDArray[np.int64]:
        """See PlaceIndex."""
        self._learn()
        ids, alive = self._rows.ids[: self._compared()], self._rows.alive[: self._compared()]
        return ids if alive.all() else ids[alive]

    def differing(self, entries: Sequence[IndexEntry], vectors: Array) -> list[int]:
        """See PlaceIndex."""
        self._learn()
        differing = set(self._rows.differing(entries, vectors))
        if self._flat is not None:
            rows = np.array([self._rows.row_of[entry.id] for entry in entries if entry.id not in differing], np.intp)
            differing.update(self._rows.ids[rows[self._flat.differs(rows, self._standardised(rows))]].tolist())
        return [entry.id for entry in entries if entry.id in differing]

    def shared_of(self, ids: Sequence[int]) -> Indices:
        """Which of the shared rows hold those entries."""
        return self._rows.shared_of(ids)

    @property
    def own_rows(self) -> int:
        """How many rows are in this process's own memory."""
        return self._rows.count - self._rows.vectors.shared_count

    @property
    def codes_learned_at(self) -> int:
        """Of how many entries the codes were learned by which it is searched, 0 for none."""
        return 0 if self._codes is None else self._codes.learned_at

    def stored(self) -> StoredIndex:
        """The state for `restored` to answer as this index does now, without removed entries. Raises RowDiffers."""
        self._learn()
        rows, live = self._rows, self._rows.live()
        arrays = {
            "ids": rows.ids[live],
            "sessions": rows.sessions[live],
            "ordinals": rows.ordinals[live],
            "positions": rows.positions[live],
            **self._learner.stored(live),
        }
        codes = None if self._codes is None else self._codes.copied()
        return StoredIndex(arrays, rows.vectors.frozen(), live, codes)

    @classmethod
    def restored(
        cls,
        shared: SharedRows,
        arrays: Mapping[str, NDArray[Any]],
        config: AdaptationConfig = AdaptationConfig(),
        coded_from: int = CODED_FROM,
    ) -> FaissIndex:
        """The index that was `stored` as `arrays`, over its descriptors; the arrays become its own.

        Raises DataLoss where another version has written them.
        """
        made = cls(shared.vectors.shape[1], config, coded_from)
        made._rows = Rows.restored(shared, arrays["sessions"], arrays["ordinals"], arrays["positions"])
        made._learner.restore(made._rows, arrays)
        if "codes" in arrays:
            made._flat, made._codes = None, CodedShortlist.restored(made._dimension, arrays)
        return made

    def _renumber(self, kept: Indices) -> None:
        """Rows have other numbers now: row i is the one that was `kept[i]`."""
        self._learner.renumber(self._rows, kept)
        for codes in (self._codes, self._next_codes):
            if codes is not None:
                codes.keep(kept)

    @property
    def _dimension(self) -> int:
        return self._rows.vectors.dimension

    def _compared(self) -> int:
        """How many rows the searched shortlist holds."""
        return self._flat.count if self._flat is not None else self._codes.count if self._codes is not None else 0

    def _learn(self) -> None:
        """Take in new entries; the compared form follows the statistics."""
        self._follow(self._learner.learn(self._rows))

    def _follow(self, changed: Indices) -> None:
        """The compared form takes in new rows, and those whose standardised form has `changed`."""
        if self._flat is not None:
            held = self._flat.count
            changed = changed[changed < held]
            self._flat.replace(changed, self._standardised(changed))
            self._flat.append(self._standardised(np.arange(held, self._rows.count)))

    def _standardised(self, rows: Indices) -> Array:
        return standardised(self._rows, rows, self._learner.site)

    def _shortlisted(self, query: Array, k: int, only: SearchFilter, passing: Flags) -> Indices:
        """Rows that pass the filter, the k most similar among them."""
        if self._flat is not None:
            return self._flat.nearest(asked(self._learner.site, query, only), k, passing)
        passed = int(np.count_nonzero(passing))
        wanted = max(_SHORTLIST, 4 * k, self._rows.count // _PLACES_PER_PROPOSED)
        fetched = wanted * self._rows.count // passed + min(_FEW, self._rows.count - passed)
        while self._codes is not None and passed > _FEW and fetched < self._rows.count // 2:
            rows = self._codes.nearest(query, only, fetched)
            rows = rows[passing[rows]]
            if len(rows) >= wanted:
                return rows[:wanted]
            fetched *= 4
        return np.flatnonzero(passing)

    def _prepare_codes(self, budget: int) -> None:
        """Code at most `budget` rows for the next codes; they take over once they hold all."""
        changed = np.zeros(0, np.intp)
        if self._next_codes is None and self._codes_are_due():
            changed = self._learner.learn(self._rows)
            self._next_codes = CodedShortlist.learned(self._rows, self._learner.site)
        if self._next_codes is None:
            return
        self._next_codes.append(self._rows, min(self._next_codes.count + budget, self._rows.count))
        if self._next_codes.count == self._rows.count:
            self._flat, self._codes, self._next_codes = None, self._next_codes, None
        elif len(changed):
            self._follow(changed)

    def _codes_are_due(self) -> bool:
        learned_at = 0 if self._codes is None else self._codes.learned_at
        due = max(self._coded_from, _CODES_ARE_LEARNED_ANEW_AFTER * learned_at)
        return len(self) > due and CodedShortlist.fits(self._dimension)
