"""The gateway's index: loaded before the service is ready, then compared with the database and repaired for ever."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass
from functools import partial

import structlog

from revisit.service.application.contract.index import IndexChange, VectorIndex
from revisit.service.application.contract.records import MapRecord, SubmapRecord
from revisit.service.application.contract.states import SubmapState
from revisit.service.application.contract.storage import Storage
from revisit.service.application.contract.transactions import UnitOfWork
from revisit.service.application.query.place_memory import PlaceMemory

WINDOW = 256
"""Descriptors that one turn of the audit compares: a few milliseconds, for requests wait meanwhile."""

MAPS = 8
"""Maps that one turn looks at, at most."""

log = structlog.get_logger(__name__)


@dataclass
class IndexHealth:
    """How this process's index compares with the database.

    `loading`: it is being loaded after a start, and the service is not ready. `drift`: the submaps found to differ, and
    repaired, since then.
    """

    loading: bool = False
    drift: int = 0


class IndexKeeper:
    """Loads the index of every map once, then compares it with the database, a window at a time."""

    def __init__(self, storage: Storage, index: VectorIndex, memory: PlaceMemory, health: IndexHealth) -> None:
        """`memory` brings `index` up to date. From now on the service is not ready, until `load` is done."""
        self._storage = storage
        self._index = index
        self._memory = memory
        self._health = health
        self._last_map = 0
        self._last_submap: dict[int, int] = {}
        health.loading = True

    async def load(self) -> None:
        """Bring the index of every map up to the database; nothing once that was done."""
        if not self._health.loading:
            return
        began_s = time.perf_counter()
        maps = await self._storage.read(lambda uow: uow.maps.of_all_tenants())
        for record in maps:
            await asyncio.to_thread(self._memory.catch_up, record.tenant, record.number)
        self._health.loading = False
        submaps = sum(self._index.size(record.number) for record in maps)
        log.info("index_loaded", maps=len(maps), submaps=submaps, took_s=round(time.perf_counter() - began_s, 3))

    async def audit(self) -> int:
        """Compare the next maps, until a window of descriptors is done; how many submaps differed and were mended."""
        if self._health.loading:
            return 0
        maps = await self._storage.read(lambda uow: uow.maps.of_all_tenants(after=self._last_map, limit=MAPS))
        drift = compared = 0
        for record in maps:
            found, looked_at = await asyncio.to_thread(self._audit_map, record)
            drift, compared = drift + found, compared + looked_at
            if record.number in self._last_submap:
                return drift
            self._last_map = record.number
            if compared >= WINDOW:
                return drift
        if len(maps) < MAPS:
            self._last_map = 0
        return drift

    def _audit_map(self, record: MapRecord) -> tuple[int, int]:
        """The next window of a map's submaps; how many differed, how many were compared."""
        tenant, number, index = record.tenant, record.number, self._index
        self._memory.catch_up(tenant, number)
        seq, held = index.numbers(number)
        after = self._last_submap.pop(number, 0)
        window = self._storage.transactions.read(partial(_window, record=record, after=after)).result()
        if window is None:
            return 0, 0
        held = held[held > after]
        if len(window) == WINDOW:
            self._last_submap[number] = window[-1].number
            held = held[held <= window[-1].number]
        live = {submap.number for submap in window}
        suspects = (live ^ set(held.tolist())).union(index.differing(number, [_place(submap) for submap in window]))
        # What has changed since the index was looked at differs rightly.
        newer = self._storage.transactions.read(lambda uow: uow.changes.since(tenant, number, seq)).result()
        drift = suspects.difference(change.submap_number for change in newer)
        if drift:
            self._mend(record, len(drift))
        return len(drift), len(window)

    def _mend(self, record: MapRecord, drift: int) -> None:
        """Load the map's index anew; searches meanwhile wait for it (see `PlaceMemory.recall`)."""
        log.error("index_drift", tenant=record.tenant, map=record.map_id, submaps=drift)
        self._health.drift += drift
        self._index.drop(record.number)
        self._memory.catch_up(record.tenant, record.number)


def _window(uow: UnitOfWork, record: MapRecord, after: int) -> list[SubmapRecord] | None:
    """The next described submaps of a map; None where the map was deleted."""
    if uow.maps.get(record.tenant, record.map_id) is None:
        return None
    described = {"map_id": record.map_id, "state": SubmapState.DESCRIBED.value}
    return uow.submaps.find(record.tenant, after=after, limit=WINDOW, **described)


def _place(submap: SubmapRecord) -> IndexChange:
    """A described submap as its index holds it."""
    place = (submap.session_number, submap.ordinal, submap.position_m)
    return IndexChange(0, submap.number, *place, submap.descriptor)
