"""One vector index per map: the bookkeeping of the port around a nearest-neighbour index of `core.index`."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.service.application.contract.index import IndexChange, VectorFilter, VectorMatch

if TYPE_CHECKING:
    from revisit.core.index import IndexEntry, PlaceIndex, SearchFilter

MakeIndex = Callable[[int], "PlaceIndex"]
"""An empty index for descriptors of the given dimension."""


@dataclass
class _MapIndex:
    """The index of one map, made when its first descriptor shows the dimension."""

    seq: int = 0
    dimension: int = 0
    places: PlaceIndex | None = None
    present: set[int] = field(default_factory=set)
    lock: threading.Lock = field(default_factory=threading.Lock)


class PlaceVectorIndex:
    """`VectorIndex` over `core.index`."""

    def __init__(self, make_index: MakeIndex) -> None:
        """`make_index` gives an empty index of `core.index`, exact or FAISS."""
        self._make_index = make_index
        self._maps: dict[int, _MapIndex] = {}
        self._lock = threading.Lock()

    def seq(self, map_number: int) -> int:
        """See `VectorIndex`."""
        return self._of(map_number).seq

    def apply(self, map_number: int, changes: Sequence[IndexChange], after: int = 0) -> None:
        """See `VectorIndex`."""
        index = self._of(map_number)
        with index.lock:
            new = [change for change in changes if change.seq > index.seq]
            if not new or index.seq < after:
                return
            last = {change.submap_number: change for change in new}
            self._remove(index, [number for number in last if number in index.present])
            self._add(index, [change for change in last.values() if change.vector is not None])
            index.seq = new[-1].seq

    def search(self, map_number: int, vector: NDArray[np.float32], k: int, where: VectorFilter) -> list[VectorMatch]:
        """See `VectorIndex`."""
        index = self._of(map_number)
        with index.lock:
            if index.places is None or not index.present:
                return []
            if vector.shape != (index.dimension,):
                raise BadField(f"a descriptor of this map has {index.dimension} values", field="descriptor")
            # The query's own submap may be among the nearest: ask for one more and leave it out.
            matches = index.places.search(vector, k + 1, _search_filter(where))
        others = (match for match in matches if match.id != where.exclude_submap)
        return [VectorMatch(match.id, match.similarity) for match in others][:k]

    def size(self, map_number: int) -> int:
        """See `VectorIndex`."""
        return len(self._of(map_number).present)

    def drop(self, map_number: int) -> None:
        """See `VectorIndex`."""
        with self._lock:
            self._maps.pop(map_number, None)

    def numbers(self, map_number: int) -> tuple[int, NDArray[np.int64]]:
        """See `VectorIndex`."""
        index = self._of(map_number)
        with index.lock:
            return index.seq, np.zeros(0, np.int64) if index.places is None else index.places.ids()

    def differing(self, map_number: int, places: Sequence[IndexChange]) -> list[int]:
        """See `VectorIndex`."""
        index = self._of(map_number)
        with index.lock:
            if index.places is None:
                return [place.submap_number for place in places]
            return index.places.differing(*_entries(places)) if places else []

    def _of(self, map_number: int) -> _MapIndex:
        with self._lock:
            return self._maps.setdefault(map_number, _MapIndex())

    def _remove(self, index: _MapIndex, numbers: list[int]) -> None:
        if index.places is not None and numbers:
            index.places.remove(numbers)
            index.present.difference_update(numbers)

    def _add(self, index: _MapIndex, changes: list[IndexChange]) -> None:
        if not changes:
            return
        entries, vectors = _entries(changes)
        if index.places is None:
            index.dimension = vectors.shape[1]
            index.places = self._make_index(index.dimension)
        index.places.add(entries, vectors)
        index.present.update(change.submap_number for change in changes)


def _entries(changes: Sequence[IndexChange]) -> tuple[list[IndexEntry], NDArray[np.float32]]:
    from revisit.core.index import IndexEntry

    vectors = np.stack([np.frombuffer(change.vector or b"", dtype="<f4") for change in changes])
    entries = [
        IndexEntry(
            id=change.submap_number,
            session=change.session_number,
            ordinal=change.ordinal,
            position=np.asarray(change.position_m, dtype=np.float64),
        )
        for change in changes
    ]
    return entries, vectors


def _search_filter(where: VectorFilter) -> SearchFilter:
    from revisit.core.index import SearchFilter

    near = None if where.near_session is None else (where.near_session, where.near_ordinal, where.min_gap)
    return SearchFilter(
        exclude_session=where.exclude_session,
        only_session=where.only_session,
        near=near,
        position=None if where.position_m is None else np.asarray(where.position_m, dtype=np.float64),
        radius_m=where.radius_m,
    )
