"""One vector index per map: the bookkeeping of the port around a nearest-neighbour index of `core.index`.

A large map has a file (docs/decisions/0046): its descriptors are mapped from there, and only those that came later are
in this process's own memory. After any error of a file the map is forgotten, and loaded again from the database.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import structlog
from numpy.typing import NDArray

from revisit.core.errors import BadField, DataLoss
from revisit.service.engines.local.files.index_files import IndexFiles
from revisit.service.ports.index import IndexChange, VectorFilter, VectorMatch

if TYPE_CHECKING:
    from revisit.core.index import FaissIndex, IndexEntry, Match, PlaceIndex, RowDiffers, SearchFilter

MakeIndex = Callable[[int], "PlaceIndex"]
"""An empty index for descriptors of the given dimension."""


SAVED_FROM = 4096
"""Entries from which a map has a file, and that must have come for another one: below, 16 MB are soon read."""

TRACES_KEPT_S = 600.0
"""Delay after which a file drops the rest of a removed entry (id, position, code, sums); its descriptor goes at once.
"""

_OWN_SHARE = 0.125
"""A file is written anew once a process has this share of a map in its own memory."""

log = structlog.get_logger(__name__)


@dataclass
class _MapIndex:
    """The index of one map, made when its first descriptor shows the dimension; `file` is its source."""

    seq: int = 0
    dimension: int = 0
    entries: PlaceIndex | None = None
    file: str | None = None
    codes_learned_at: int = 0  # in the file
    erased_at_s: float | None = None  # when something of the file was first removed
    lock: threading.Lock = field(default_factory=threading.Lock)

    def forget(self) -> None:
        """Begin anew; `lock` is held."""
        self.seq, self.entries, self.file, self.codes_learned_at, self.erased_at_s = 0, None, None, 0, None


class PlaceVectorIndex:
    """`VectorIndex` over `core.index`."""

    def __init__(
        self, make_index: MakeIndex, files: IndexFiles | None = None, *, saved_from: int | None = None
    ) -> None:
        """`make_index` gives an empty index of `core.index`, exact or FAISS.

        Maps are loaded from `files`, if given. The one process that writes them does so `saved_from` entries on.
        """
        self._make_index = make_index
        self._files = files
        self._saved_from = saved_from
        self._traces_kept_s = TRACES_KEPT_S
        self._maps: dict[int, _MapIndex] = {}
        self._distrusted: set[str] = set()
        self._differed: dict[int, tuple[str | None, int]] = {}
        self._lock = threading.Lock()

    def seq(self, map_number: int) -> int:
        """See `VectorIndex`."""
        return self._of(map_number).seq

    def apply(self, map_number: int, changes: Sequence[IndexChange], after: int = 0, *, more: bool = False) -> None:
        """See `VectorIndex`."""
        index = self._of(map_number)
        with index.lock:
            new = [change for change in changes if change.seq > index.seq]
            if not new or index.seq < after:
                return
            sessions = {change.session_number for change in new if change.whole_session}
            last = {change.submap_number: change for change in new if change.session_number not in sessions}
            if self._is_replaced(index, new):
                index.forget()
                return
            with self._mended(map_number, index):
                self._remove(index, [*last, *_ids_of(index, sessions)])
                self._add(index, [change for change in last.values() if change.vector is not None], more)
                index.seq = new[-1].seq

    def search(self, map_number: int, vector: NDArray[np.float32], k: int, where: VectorFilter) -> list[VectorMatch]:
        """See `VectorIndex`."""
        index = self._of(map_number)
        with index.lock:
            if index.entries is None or not len(index.entries):
                return []
            if vector.shape != (index.dimension,):
                raise BadField(f"a descriptor of this map has {index.dimension} values", field="descriptor")
            matches: list[Match] = []
            with self._mended(map_number, index):
                matches = index.entries.search(vector, k, _search_filter(where))
        return [VectorMatch(match.id, match.similarity) for match in matches]

    def size(self, map_number: int, sessions: Collection[int] | None = None) -> int:
        """See `VectorIndex`."""
        index = self._of(map_number)
        if sessions is None:
            return _size(index)
        with index.lock:
            return 0 if index.entries is None else index.entries.count_of(sessions)

    def drop(self, map_number: int) -> None:
        """See `VectorIndex`."""
        with self._lock:
            index = self._maps.pop(map_number, None)
        if index is not None and index.file is not None:
            self._distrusted.add(index.file)
            if self._files is not None and self._saved_from is not None:
                self._files.delete(index.file)

    def numbers(self, map_number: int) -> tuple[int, NDArray[np.int64]]:
        """See `VectorIndex`."""
        index = self._of(map_number)
        with index.lock:
            held = np.zeros(0, np.int64)
            if index.entries is not None:
                with self._mended(map_number, index):
                    held = index.entries.ids()
            return index.seq, held

    def differing(self, map_number: int, entries: Sequence[IndexChange]) -> list[int]:
        """See `VectorIndex`."""
        index = self._of(map_number)
        with index.lock:
            if index.entries is None:
                return [place.submap_number for place in entries]
            differing = [place.submap_number for place in entries]
            with self._mended(map_number, index):
                differing = index.entries.differing(*_entries(entries, index.dimension)) if entries else []
        return differing

    def save(self, map_number: int) -> str | None:
        """See `SharedIndex`."""
        index, stored = self._of(map_number), None
        with index.lock:
            entries = index.entries
            if self._files is None or not isinstance(entries, _faiss_index()) or not self._is_due(index, entries):
                return None
            seq = index.seq
            with self._mended(map_number, index):
                stored = entries.stored()
        try:
            return None if stored is None else self._files.write(seq, stored)
        except (OSError, _row_differs()) as error:
            log.warning("index_file_not_written", map=map_number, reason=str(error) or type(error).__name__)
            return None

    def load(self, map_number: int, name: str) -> bool:
        """See `SharedIndex`."""
        if self._files is None or name in self._distrusted:
            return False
        from revisit.core.index import FaissIndex, SharedRows

        opened = self._files.open(name, whole=self._saved_from is not None)
        if opened is None:
            self._distrusted.add(name)
            return False
        try:
            entries = FaissIndex.restored(SharedRows(opened.arrays["ids"], opened.vectors, opened.marks), opened.arrays)
        except DataLoss as error:
            log.warning("index_file_of_another_form", map=map_number, reason=str(error))
            self._distrusted.add(name)
            return False
        index = self._of(map_number)
        with index.lock:
            index.seq, index.dimension, index.entries, index.file = opened.seq, opened.vectors.shape[1], entries, name
            index.codes_learned_at, index.erased_at_s = entries.codes_learned_at, None
        return True

    def large(self) -> list[int]:
        """See `SharedIndex`."""
        with self._lock:
            maps = list(self._maps.items())
        least = self._saved_from or SAVED_FROM
        return [number for number, index in maps if index.file is not None or _size(index) >= least]

    def keep(self, names: Collection[str]) -> None:
        """See `SharedIndex`."""
        if self._files is not None and self._saved_from is not None:
            self._files.keep(names)

    def _is_due(self, index: _MapIndex, entries: FaissIndex) -> bool:
        """Whether a file would spare other processes much, or the one there is holds traces for too long."""
        if self._saved_from is None or not len(entries):
            return False
        if index.erased_at_s is not None and time.monotonic() - index.erased_at_s >= self._traces_kept_s:
            return True
        if len(entries) < self._saved_from:
            return False
        if index.file is None or index.codes_learned_at != entries.codes_learned_at:
            return True
        return entries.own_rows >= max(self._saved_from, int(_OWN_SHARE * len(entries)))

    def _erase(self, index: _MapIndex, numbers: list[int]) -> None:
        """Take the bytes of removed entries out of the file, or the file away."""
        entries, files, name = index.entries, self._files, index.file
        if files is None or name is None or not isinstance(entries, _faiss_index()):
            return
        rows = entries.shared_of(numbers)
        if self._saved_from is None or not len(rows):
            return
        if index.erased_at_s is None:
            index.erased_at_s = time.monotonic()
        try:
            files.erase(name, rows, 4 * index.dimension)
        except OSError as error:
            log.warning("index_file_not_erased", file=name, reason=str(error))
            files.delete(name)

    @contextmanager
    def _mended(self, map_number: int, index: _MapIndex) -> Iterator[None]:
        """Forget the map where its file is found wrong, so that it is loaded again.

        A row that was erased since the changes were read is dead once they are; so the file is only distrusted where
        it is wrong a second time as of the same change.
        """
        try:
            yield
        except _row_differs():
            found = index.file, index.seq
            log.warning("index_file_differs", map=map_number, seq=index.seq)
            if index.file is not None and self._differed.get(map_number) == found:
                self._distrusted.add(index.file)
            self._differed[map_number] = found
            index.forget()

    def _of(self, map_number: int) -> _MapIndex:
        with self._lock:
            return self._maps.setdefault(map_number, _MapIndex())

    def _is_replaced(self, index: _MapIndex, changes: Sequence[IndexChange]) -> bool:
        """Whether an entry goes from a file that is not the one this process reads."""
        if self._files is None or index.file is None or all(change.vector is not None for change in changes):
            return False
        return not self._files.exists(index.file)

    def _remove(self, index: _MapIndex, numbers: list[int]) -> None:
        if index.entries is not None:
            self._erase(index, numbers)
            index.entries.remove(numbers)

    def _add(self, index: _MapIndex, changes: list[IndexChange], more: bool) -> None:
        if index.entries is None:
            if not changes:
                return
            index.dimension = len(changes[0].vector or b"") // 4
            index.entries = self._make_index(index.dimension)
        # Also where none came: with the last portion the index gets fast.
        index.entries.add(*_entries(changes, index.dimension), more=more)


def _ids_of(index: _MapIndex, sessions: Collection[int]) -> list[int]:
    """The submaps of these sessions that it holds."""
    return [] if index.entries is None or not sessions else index.entries.ids_of(sessions).tolist()


def _size(index: _MapIndex) -> int:
    return 0 if index.entries is None else len(index.entries)


def _faiss_index() -> type[FaissIndex]:
    """Imported when a map is loaded: much of the command line needs none."""
    from revisit.core.index import FaissIndex

    return FaissIndex


def _row_differs() -> type[RowDiffers]:
    from revisit.core.index import RowDiffers

    return RowDiffers


def _entries(changes: Sequence[IndexChange], dimension: int) -> tuple[list[IndexEntry], NDArray[np.float32]]:
    from revisit.core.index import IndexEntry

    vectors = [np.frombuffer(change.vector or b"", dtype="<f4") for change in changes]
    entries = [
        IndexEntry(
            id=change.submap_number,
            session=change.session_number,
            ordinal=change.ordinal,
            position=np.asarray(change.position_m, dtype=np.float64),
        )
        for change in changes
    ]
    return entries, np.stack(vectors) if vectors else np.zeros((0, dimension), dtype=np.float32)


def _search_filter(where: VectorFilter) -> SearchFilter:
    from revisit.core.index import SearchFilter

    return SearchFilter(
        exclude_session=where.exclude_session,
        only_session=where.only_session,
        only_sessions=where.only_sessions,
        of_session=where.of_session,
        without=where.without,
        position=None if where.position_m is None else np.asarray(where.position_m, dtype=np.float64),
        radius_m=where.radius_m,
    )
