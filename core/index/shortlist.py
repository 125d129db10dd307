"""Which rows are worth an exact look: all of a small map, by FAISS; the most alike of a large one, by short codes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import faiss
import numpy as np
from numpy.typing import NDArray

from revisit.core.descriptor.adaptation import SiteStatistics
from revisit.core.index.entries import Array, Flags, SearchFilter
from revisit.core.index.exact import asked, standardised
from revisit.core.index.learning import site_as_arrays, site_of_arrays
from revisit.core.index.rows import Rows

Indices = NDArray[np.intp]

_BITS = 4
_ENTRIES_PER_CODE = 4
_TRAINED_ON = 2048
_ITERATIONS = 8
_CODED_AT_ONCE = 1024
_TIE = 1.1e-3
"""By how much the cosines of two rows may be the other way round in half precision: twice 2^-11, the share of itself by
which an entry is off at most, and something for sums in single precision."""


class FlatShortlist:
    """The standardised descriptors of all rows in FAISS, in half precision: what it answers holds every row that may be
    among the best.
    """

    def __init__(self, dimension: int) -> None:
        self._faiss: Any = faiss.IndexScalarQuantizer(
            dimension, faiss.ScalarQuantizer.QT_fp16, faiss.METRIC_INNER_PRODUCT
        )

    @property
    def count(self) -> int:
        """How many rows it holds."""
        return int(self._faiss.ntotal)

    def append(self, standardised: Array) -> None:
        """Add the next rows."""
        self._faiss.add(standardised)

    def replace(self, rows: Indices, standardised: Array) -> None:
        """Rows have another standardised form."""
        self._stored()[rows] = self._faiss.sa_encode(standardised)

    def differs(self, rows: Indices, standardised: Array) -> Flags:
        """Which of the rows (n,) are not held, or not bit for bit as `standardised` (n, d) is in half precision."""
        held = rows < self.count
        same = np.zeros(len(rows), dtype=bool)
        same[held] = (self._stored()[rows[held]] == self._faiss.sa_encode(standardised[held])).all(axis=1)
        return ~same

    def nearest(self, query: Array, k: int, passing: Flags) -> Indices:
        """The rows that pass and are among the k most similar, and those that half precision cannot tell from them."""
        allowed = int(passing.sum())
        selector: Any = faiss.IDSelectorBitmap  # of an array, as the wrapper of FAISS takes it
        parameters = faiss.SearchParameters()
        parameters.sel = selector(np.packbits(passing, bitorder="little"))
        wanted = min(2 * k, allowed)
        while True:
            similar, rows = self._faiss.search(query[None], wanted, params=parameters)
            if wanted == allowed or similar[0, -1] < similar[0, k - 1] - _TIE:
                return np.asarray(rows[0], dtype=np.intp)
            wanted = min(2 * wanted, allowed)

    def _stored(self) -> NDArray[np.uint8]:
        codes = self._faiss.codes
        return np.asarray(faiss.rev_swig_ptr(codes.data(), codes.size())).reshape(self.count, self._faiss.code_size)


class CodedShortlist:
    """Product codes of the rows, 4 bits for every 4 entries, standardised as the map was when the codes were learned.

    Approximate: the k most similar rows are among a few hundred of its answers (figures: docs/decisions/0112).
    """

    def __init__(self, dimension: int, site: SiteStatistics | None, learned_at: int) -> None:
        """Codes that are not learned yet: see `learned` and `restored`. `learned_at`: of how many entries."""
        self.learned_at = learned_at
        self._site = site
        self._faiss: Any = faiss.IndexPQFastScan(
            dimension, max(dimension // _ENTRIES_PER_CODE, 1), _BITS, faiss.METRIC_INNER_PRODUCT
        )

    @classmethod
    def learned(cls, rows: Rows, site: SiteStatistics | None) -> CodedShortlist:
        """Codes learned from a part of the `rows`; none is coded yet."""
        live = rows.live()
        made = cls(rows.vectors.dimension, site, len(live))
        made._faiss.pq.cp.niter = _ITERATIONS
        made._faiss.pq.cp.min_points_per_centroid = 1  # it warns below
        chosen = live[np.linspace(0, len(live) - 1, min(len(live), _TRAINED_ON)).astype(np.intp)]
        made._faiss.train(standardised(rows, chosen, site))
        made._faiss.pq.sync_transposed_centroids()  # codes are found by them in four fifths of the time
        return made

    def copied(self) -> CodedShortlist:
        """The same codes, on their own."""
        same = CodedShortlist(self._faiss.d, self._site, self.learned_at)
        same._faiss = faiss.clone_index(self._faiss)
        return same

    def stored(self) -> dict[str, NDArray[np.generic]]:
        """The codes and how they were learned, as arrays that do not change with it."""
        return {
            "codes": self._table().copy(),
            "coded": np.array([self.count, self.learned_at]),
            "centroids": faiss.vector_to_array(self._faiss.pq.centroids).copy(),
            **site_as_arrays(self._site, "coded_"),
        }

    @classmethod
    def restored(cls, dimension: int, arrays: Mapping[str, NDArray[Any]]) -> CodedShortlist:
        """From its `stored` state."""
        count, learned_at = arrays["coded"].tolist()
        made = cls(dimension, site_of_arrays(arrays, "coded_"), learned_at)
        faiss.copy_array_to_vector(arrays["centroids"], made._faiss.pq.centroids)
        made._faiss.pq.sync_transposed_centroids()
        made._faiss.codes.resize(len(arrays["codes"]))
        made._table()[:] = arrays["codes"]
        made._faiss.ntotal, made._faiss.is_trained = count, True
        made._faiss.ntotal2 = 2 * len(arrays["codes"]) // made._faiss.M2
        return made

    @staticmethod
    def fits(dimension: int) -> bool:
        """Whether descriptors of this many entries can be coded."""
        return dimension % _ENTRIES_PER_CODE == 0

    @property
    def count(self) -> int:
        """How many rows it holds."""
        return int(self._faiss.ntotal)

    def append(self, rows: Rows, end: int) -> None:
        """Add the next rows, as far as row `end`."""
        for start in range(self.count, end, _CODED_AT_ONCE):
            self._faiss.add(standardised(rows, np.arange(start, min(start + _CODED_AT_ONCE, end)), self._site))

    def keep(self, rows: Indices) -> None:
        """Only those rows stay, in their order, and are numbered anew."""
        gone = np.ones(self.count, dtype=bool)
        gone[rows[rows < self.count]] = False
        selector: Any = faiss.IDSelectorBitmap  # of an array, as the wrapper of FAISS takes it
        self._faiss.remove_ids(selector(np.packbits(gone, bitorder="little")))

    def nearest(self, query: Array, only: SearchFilter, count: int) -> Indices:
        """`count` rows, the most similar to the unit query (d,) first, whether or not they pass the filter."""
        rows = self._faiss.search(asked(self._site, query, only)[None], min(count, self.count))[1][0]
        return np.asarray(rows[rows >= 0], dtype=np.intp)

    def _table(self) -> NDArray[np.uint8]:
        codes = self._faiss.codes
        return np.asarray(faiss.rev_swig_ptr(codes.get(), codes.size()))
