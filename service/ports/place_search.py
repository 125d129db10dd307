"""Search for the places of a map that are most like a descriptor, wherever the index of the map is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.service.domain.identity import TenantId
from revisit.service.ports.index import VectorFilter, VectorMatch
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class PlaceQuestion:
    """The `k` submaps of a map most like `vector` (d,), of those that `where` lets pass.

    `before`: only submaps that entered the index before this change, and no need to know of later ones.
    """

    tenant: TenantId
    map_number: int
    vector: NDArray[np.float32]
    k: int
    where: VectorFilter
    before: int | None = None


@dataclass(frozen=True)
class PlaceAnswer:
    """Most similar first, ties by number. `searched` submaps are in the index, `on_other_storeys` of them left out."""

    matches: tuple[VectorMatch, ...]
    searched: int
    on_other_storeys: int = 0


class PlaceSearch(Protocol):
    """Answers from an index that has caught up with the database. All calls block."""

    def nearest(self, question: PlaceQuestion) -> PlaceAnswer:
        """The answer as of every change that was committed before the call, or as of `before`.

        Raises BadField for a descriptor of another dimension, Unavailable where no index can be reached.
        """
        ...

    def nearest_in(self, uow: UnitOfWork, question: PlaceQuestion, version: int | None) -> PlaceAnswer | None:
        """The answer as of the snapshot of `uow`, where the index can have it at once; else None.

        `version`: that of the store before the snapshot. Raises BadField.
        """
        ...


class SearchElsewhere(PlaceSearch, Protocol):
    """A search that other processes answer."""

    def anywhere(self) -> bool:
        """Whether there are, or were, such processes, so that this one needs no index. Blocks."""
        ...
