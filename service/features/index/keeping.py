"""The gateway's index: loaded before the service is ready, then compared with the database and repaired for ever."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import structlog

from revisit.core.errors import DataLoss
from revisit.service.domain.errors import NotFound
from revisit.service.domain.records import MapRecord, SubmapRecord
from revisit.service.domain.states import SubmapState
from revisit.service.failpoints import failpoint
from revisit.service.features.index.caught_up_index import CaughtUpIndex
from revisit.service.ports.disk import DiskSpace
from revisit.service.ports.index import IndexChange, VectorIndex
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork

WINDOW = 32
"""Descriptors that one turn of the audit compares: two milliseconds, for requests wait meanwhile."""

MAPS = 2
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

    def __init__(
        self,
        storage: Storage,
        index: VectorIndex,
        caught_up: CaughtUpIndex,
        health: IndexHealth,
        disk: DiskSpace,
        holds: Callable[[int], bool] = lambda _: True,
    ) -> None:
        """`caught_up` brings `index` up to date. From now on the service is not ready, until `load` is done.

        No file is written where `disk` is full. Only maps are kept, by number, that this process `holds`.
        """
        self._storage = storage
        self._index = index
        self._caught_up = caught_up
        self._health = health
        self._disk = disk
        self._holds = holds
        self._last_map = 0
        self._last_submap: dict[int, int] = {}
        health.loading = True

    async def load(self) -> None:
        """Bring the index of every map up to the database; nothing once that was done.

        A map with damaged rows is passed over.
        """
        if not self._health.loading:
            return
        began_s = time.perf_counter()
        maps = await self._storage.read(lambda uow: uow.maps.of_all_tenants())
        for record in filter(self._is_held, maps):
            try:
                await asyncio.to_thread(self._caught_up.catch_up, record.tenant, record.number)
            except DataLoss as error:  # as searches in this map will be told
                log.error("index_not_loaded", tenant=record.tenant, map=record.map_id, reason=error.reason)
        await self._keep_named_files()
        self._health.loading = False
        submaps = sum(self._index.size(record.number) for record in maps)
        log.info("index_loaded", maps=len(maps), submaps=submaps, took_s=round(time.perf_counter() - began_s, 3))

    async def tend_files(self) -> int:
        """Bring the large maps up to the database, so that deleted entries leave their files, too; write the files that
        are due.

        How many were saved.
        """
        if self._health.loading:
            return 0
        saved = 0
        for number in self._index.large():
            found = await self._storage.read(partial(_next_map, after=number - 1))
            if found is not None and found.number == number:
                await asyncio.to_thread(self._caught_up.catch_up, found.tenant, number)
                saved += await self._save(found)
        if saved:
            await self._keep_named_files()
        return saved

    async def _save(self, record: MapRecord) -> bool:
        """Write a file of a map's index where one is due, name it in the database, and go on from it."""
        if self._disk.full():
            return False
        name = await asyncio.to_thread(self._index.save, record.number)
        if name is None:
            return False
        failpoint("index.before_file_named")
        with suppress(NotFound):  # the map was deleted meanwhile, and the file goes with the next others
            await self._storage.write(lambda uow: uow.maps.revise([record], index_file=name))
        failpoint("index.after_file_named")
        await asyncio.to_thread(self._index.load, record.number, name)
        await asyncio.to_thread(self._caught_up.catch_up, record.tenant, record.number)
        log.info("index_file_written", map=record.map_id, submaps=self._index.size(record.number))
        return True

    async def _keep_named_files(self) -> None:
        """Delete the files that no map names."""
        maps = await self._storage.read(lambda uow: uow.maps.of_all_tenants())
        names = {record.index_file for record in maps if record.index_file is not None}
        await asyncio.to_thread(self._index.keep, names)

    async def audit(self) -> int:
        """Compare the next maps, until a window of descriptors is done; how many submaps differed and were mended."""
        return 0 if self._health.loading else await asyncio.to_thread(self.audit_here)

    def audit_here(self) -> int:
        """One turn of `audit`, which blocks its thread from beginning to end."""
        read_here = self._storage.transactions.read_here
        maps = read_here(partial(_maps_after, after=self._last_map)) or read_here(partial(_maps_after, after=0))
        drift = compared = 0
        for record in filter(self._is_held, maps):
            found, looked_at = self._audit_readable(record)
            drift, compared = drift + found, compared + looked_at
            if record.number in self._last_submap:
                return drift
            self._last_map = record.number
            if compared >= WINDOW:
                return drift
        self._last_map = maps[-1].number if maps else 0
        return drift

    def _audit_readable(self, record: MapRecord) -> tuple[int, int]:
        """As `_audit_map`; nothing of a map with damaged rows."""
        try:
            return self._audit_map(record)
        except DataLoss as error:
            log.error("index_not_audited", tenant=record.tenant, map=record.map_id, reason=error.reason)
            return 0, 0

    def _is_held(self, record: MapRecord) -> bool:
        return self._holds(record.number)

    def _audit_map(self, record: MapRecord) -> tuple[int, int]:
        """The next window of a map's submaps; how many differed, how many were compared."""
        tenant, number, index = record.tenant, record.number, self._index
        self._caught_up.catch_up(tenant, number)
        seq, held = index.numbers(number)
        after = self._last_submap.pop(number, 0)
        read_here = self._storage.transactions.read_here
        window = read_here(partial(_window, record=record, after=after))
        if window is None:
            return 0, 0
        of_window = held > after
        if len(window) == WINDOW:
            self._last_submap[number] = window[-1].number
            of_window &= held <= window[-1].number
        held = held[of_window]
        # One with a damaged descriptor is in no index.
        sound = [submap for submap in window if submap.descriptor is not None]
        live = {submap.number for submap in sound}
        suspects = (live ^ set(held.tolist())).union(index.differing(number, [_place(submap) for submap in sound]))
        if not suspects:
            return 0, len(window)
        # Changes since the index was read differ rightly.
        newer = read_here(lambda uow: uow.changes.since(tenant, number, seq))
        if any(change.whole_session for change in newer):
            return 0, len(window)
        drift = suspects.difference(change.submap_number for change in newer)
        if drift:
            self._mend(record, len(drift))
        return len(drift), len(window)

    def _mend(self, record: MapRecord, drift: int) -> None:
        """Load the map's index anew; searches meanwhile wait for it (see `CaughtUpIndex.nearest`)."""
        log.error("index_drift", tenant=record.tenant, map=record.map_id, submaps=drift)
        self._health.drift += drift
        self._index.drop(record.number)
        self._caught_up.catch_up(record.tenant, record.number)


def _maps_after(uow: UnitOfWork, after: int) -> list[MapRecord]:
    """The next maps of any tenant; damaged ones are passed over."""
    return uow.maps.of_all_tenants(after=after, limit=MAPS)


def _next_map(uow: UnitOfWork, after: int) -> MapRecord | None:
    """The first map of any tenant numbered above `after`."""
    return next(iter(uow.maps.of_all_tenants(after=after, limit=1)), None)


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
