"""The search processes that answer for a map, told by everybody from the list of those that live."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class SearchProcess:
    """A search process: where it is asked, whether its maps are loaded, and those that keep it too busy, by number."""

    process_id: str
    address: str
    ready: bool = False
    busy: frozenset[int] = frozenset()


def owners(map_number: int, processes: Iterable[SearchProcess]) -> list[SearchProcess]:
    """Those that hold a map: the first of its ranking, and after each one that is too busy with it the next.

    Each map ranks the processes in an order of its own (rendezvous hashing), so that only the maps of a process that
    comes or goes move.
    """
    ranked = sorted(processes, key=lambda one: _rank(map_number, one), reverse=True)
    busy = next((row for row, one in enumerate(ranked) if map_number not in one.busy), len(ranked))
    return ranked[: busy + 1]


def _rank(map_number: int, process: SearchProcess) -> bytes:
    return hashlib.sha256(f"{map_number}/{process.process_id}".encode()).digest()
