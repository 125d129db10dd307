"""The search processes that answer for a map, told by everybody from the list of those that live."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

from revisit.service.domain.processes import LivingProcess


def owners(map_number: int, processes: Iterable[LivingProcess]) -> list[LivingProcess]:
    """Those that hold a map: the first of its ranking, and after each one that is too busy with it the next.

    Each map ranks the processes in an order of its own (rendezvous hashing), so that only the maps of a process that
    comes or goes move.
    """
    ranked = sorted(processes, key=lambda one: _rank(map_number, one), reverse=True)
    busy = next((row for row, one in enumerate(ranked) if map_number not in one.busy), len(ranked))
    return ranked[: busy + 1]


def _rank(map_number: int, process: LivingProcess) -> bytes:
    return hashlib.sha256(f"{map_number}/{process.process_id}".encode()).digest()
