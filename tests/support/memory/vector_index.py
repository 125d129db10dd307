"""The vector index as its contract reads: every stored vector compared, every filter spelt out. The reference."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.service.ports.index import IndexChange, VectorFilter, VectorMatch


class MemoryVectorIndex:
    """`VectorIndex` in a dictionary per map."""

    def __init__(self) -> None:
        """Begins empty."""
        self._seq: dict[int, int] = {}
        self._places: dict[int, dict[int, tuple[IndexChange, NDArray[np.float32]]]] = {}

    def seq(self, map_number: int) -> int:
        """See `VectorIndex`."""
        return self._seq.get(map_number, 0)

    def apply(self, map_number: int, changes: Sequence[IndexChange], after: int = 0, *, more: bool = False) -> None:
        """See `VectorIndex`."""
        if self.seq(map_number) < after:
            return
        places = self._places.setdefault(map_number, {})
        for change in changes:
            if change.seq <= self.seq(map_number):
                continue
            places.pop(change.submap_number, None)
            if change.whole_session:
                of_it = [number for number, (held, _) in places.items() if held.session_number == change.session_number]
                for number in of_it:
                    del places[number]
            if change.vector is not None:
                places[change.submap_number] = (change, np.frombuffer(change.vector, dtype="<f4"))
            self._seq[map_number] = change.seq

    def search(self, map_number: int, vector: NDArray[np.float32], k: int, where: VectorFilter) -> list[VectorMatch]:
        """See `VectorIndex`."""
        if not np.isfinite(vector).all():
            raise BadField("the descriptor holds NaN or infinity", field="descriptor")
        matches = []
        for number, (change, stored) in self._places.get(map_number, {}).items():
            if stored.shape != vector.shape:
                raise BadField(f"a descriptor of this map has {len(stored)} values", field="descriptor")
            if _passes(change, where):
                matches.append(VectorMatch(number, float(stored @ vector)))
        return sorted(matches, key=lambda match: (-match.similarity, match.submap_number))[:k]

    def size(self, map_number: int, sessions: Collection[int] | None = None) -> int:
        """See `VectorIndex`."""
        places = self._places.get(map_number, {}).values()
        return sum(sessions is None or change.session_number in sessions for change, _ in places)

    def drop(self, map_number: int) -> None:
        """See `VectorIndex`."""
        self._places.pop(map_number, None)
        self._seq.pop(map_number, None)

    def save(self, map_number: int) -> str | None:
        """See `SharedIndex`."""
        return None

    def load(self, map_number: int, name: str) -> bool:
        """See `SharedIndex`."""
        return False

    def large(self) -> list[int]:
        """See `SharedIndex`."""
        return []

    def keep(self, names: Collection[str]) -> None:
        """See `SharedIndex`."""

    def numbers(self, map_number: int) -> tuple[int, NDArray[np.int64]]:
        """See `VectorIndex`."""
        return self.seq(map_number), np.array(list(self._places.get(map_number, {})), dtype=np.int64)

    def differing(self, map_number: int, places: Sequence[IndexChange]) -> list[int]:
        """See `VectorIndex`."""
        held = self._places.get(map_number, {})
        return [place.submap_number for place in places if not _same(held.get(place.submap_number), place)]


def _same(held: tuple[IndexChange, NDArray[np.float32]] | None, place: IndexChange) -> bool:
    if held is None:
        return False
    change, vector = held
    fields = (change.session_number, change.ordinal, change.position_m, vector.tobytes())
    return fields == (place.session_number, place.ordinal, place.position_m, place.vector)


def _passes(change: IndexChange, where: VectorFilter) -> bool:
    if change.submap_number in where.without or change.session_number == where.exclude_session:
        return False
    if where.only_session is not None and change.session_number != where.only_session:
        return False
    if where.only_sessions is not None and change.session_number not in where.only_sessions:
        return False
    if where.position_m is None or where.radius_m is None:
        return True
    return math.dist(change.position_m, where.position_m) <= where.radius_m
