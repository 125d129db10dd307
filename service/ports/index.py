"""A map's vector index, and the log of changes that keeps it up to date."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import MapRecord


@dataclass(frozen=True)
class IndexChange:
    """A submap entered (`vector` given) or left a map's index. `seq` grows within the map in the order of commits.

    `whole_session`: all submaps of the session left that had come before, and no single one is meant.
    """

    seq: int
    submap_number: int
    session_number: int
    ordinal: int
    position_m: tuple[float, float, float]
    vector: bytes | None
    whole_session: bool = False

    @classmethod
    def session_removed(cls, seq: int, session_number: int) -> IndexChange:
        """The submaps of a session left."""
        return cls(seq, 0, session_number, 0, (0.0, 0.0, 0.0), None, whole_session=True)


class ChangeLog(Protocol):
    """The history of a map's index, which lets any process catch up: the database is the truth, an index a cache."""

    def record_described(self, record: MapRecord, submap_number: int) -> None:
        """The submap of this map has a descriptor now. The change gets its number with the commit, and so does the
        submap's row, as `entered`.
        """
        ...

    def record_removed(self, record: MapRecord, submap_numbers: Collection[int]) -> None:
        """The submaps are gone; a change for each."""
        ...

    def record_session_removed(self, record: MapRecord, session_number: int) -> None:
        """All submaps of a session are gone, and none will come: one change."""
        ...

    def since(self, tenant: TenantId, map_number: int, seq: int, limit: int | None = None) -> list[IndexChange]:
        """The changes above `seq` in order, the first `limit` of them.

        A submap that has gone meanwhile appears only as removed.
        """
        ...


@dataclass(frozen=True)
class VectorFilter:
    """Which submaps may be hits. Sessions and submaps by number.

    `only_sessions`: submaps of other sessions are no hits, as those on other storeys (`storeys.comparable_sessions`).
    `of_session`: the session of the query. `without`: these submaps are no hits.
    """

    exclude_session: int | None = None
    only_session: int | None = None
    only_sessions: frozenset[int] | None = None
    of_session: int | None = None
    without: frozenset[int] = frozenset()
    position_m: tuple[float, float, float] | None = None
    radius_m: float | None = None


@dataclass(frozen=True)
class VectorMatch:
    """A hit: submap number and cosine similarity."""

    submap_number: int
    similarity: float


class IndexAudit(Protocol):
    """A summary of an index's content, to compare with the database."""

    def numbers(self, map_number: int) -> tuple[int, NDArray[np.int64]]:
        """`seq`, and the numbers of the submaps that it holds as of that change."""
        ...

    def differing(self, map_number: int, entries: Sequence[IndexChange]) -> list[int]:
        """The numbers of those `entries`, which have vectors, that it does not hold exactly so."""
        ...


class SharedIndex(Protocol):
    """The index of a large map as a file, which all processes of a machine share.

    One process saves. The row of the map names the file: one that it does not name is not loaded.
    """

    def save(self, map_number: int) -> str | None:
        """Write its content to a file; the name. None where it is not worth it, or there is no room."""
        ...

    def load(self, map_number: int, name: str) -> bool:
        """Replace its content by the file's; whether that succeeded. False if the file was found wrong before."""
        ...

    def large(self) -> list[int]:
        """The numbers of the maps that have a file, or are large enough for one."""
        ...

    def keep(self, names: Collection[str]) -> None:
        """Delete every other file."""
        ...


class VectorIndex(IndexAudit, SharedIndex, Protocol):
    """Nearest descriptors of one map each, keyed by map number: a cache that catches up with the change log."""

    def seq(self, map_number: int) -> int:
        """The last change applied, 0 for none."""
        ...

    def apply(self, map_number: int, changes: Sequence[IndexChange], after: int = 0, *, more: bool = False) -> None:
        """Apply the changes that follow change `after`, in order; those at or below `seq` are ignored.

        All are where `seq` is below `after`: the map was forgotten since they were read. `more` follow at once: it may
        wait for them to get fast.
        """
        ...

    def search(self, map_number: int, vector: NDArray[np.float32], k: int, where: VectorFilter) -> list[VectorMatch]:
        """The k nearest, most similar first, ties by number. Raises BadField for another dimension or NaN."""
        ...

    def size(self, map_number: int, sessions: Collection[int] | None = None) -> int:
        """How many submaps it holds, of these sessions where given."""
        ...

    def drop(self, map_number: int) -> None:
        """Forget a map, and the file that it was loaded from: it is not loaded again."""
        ...
