"""Erasure: marked rows go, a portion in each transaction, with turns for other writers in between.

A portion is small enough that nobody waits long for it: one that took long, on a busy machine, makes the next ones
smaller. After each nothing is written for as long as it took. A crash leaves the mark: the rows that are left are
nobody's to see, and go after the next start.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import structlog

from revisit.core.errors import RevisitError
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import DeletionRecord
from revisit.service.failpoints import failpoint
from revisit.service.features.deletion.blob_references import (
    blob_of_file,
    blob_of_plan,
    blob_of_tile,
    blobs_of_scans,
    blobs_of_submap,
)
from revisit.service.features.deletion.rows import drop_jobs
from revisit.service.features.graph.session_poses import PackedSubmaps, forget_in_summaries
from revisit.service.features.resources.paging import Numbered
from revisit.service.ports.clock import Clock
from revisit.service.ports.repositories import Repository
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork

ROWS = 300
"""Rows that one transaction deletes at most."""

SUBMAPS = 100
"""Submaps of one: each has a descriptor, and jobs and loop closures of its own."""

VERSIONS = 2
"""Rows of one that hold the poses of a session, or the verdicts of a map: megabytes each."""

PORTION_S = 0.04
"""Longest time of a portion's statements, by the clock; the commit follows. The next portions are sized by it."""

LEAST_SHARE = 0.05
"""Least share of its rows that a portion is made smaller to: each statement takes its time however few they are."""

AWAITED_S = 5.0
"""Longest wait of a client for the end of its deletion, which goes on without it."""

_now_s = time.perf_counter

R = TypeVar("R", bound=Numbered)

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class Portion:
    """One transaction of a deletion, begun at `at_ns`: of the rows that one deletes at most, this `share`."""

    at_ns: int
    share: float

    def most(self, rows: int) -> int:
        """How many of `rows`, one at least."""
        return max(1, round(self.share * rows))


Step = Callable[[UnitOfWork, DeletionRecord, Portion], bool]
"""Deletes a portion, in a unit of work that sees everything, and releases the blobs that its rows named; whether there
was something of this kind.
"""


class Erasure:
    """Deletes the rows of all marked resources, one portion after another."""

    def __init__(self, storage: Storage, clock: Clock) -> None:
        """Jobs of deleted submaps end at the time of `clock`."""
        self._storage = storage
        self._clock = clock
        self._turn = asyncio.Lock()
        self._under_way: dict[int, asyncio.Task[None]] = {}
        self._share = 1.0

    async def all(self) -> None:
        """Erase everything that is marked: leftovers of an earlier run, or of a client that did not wait."""
        marked = await self._storage.read(lambda uow: uow.deletions.of_all_tenants())
        for deletion in marked:
            await asyncio.wait({self._begun(deletion)})

    async def soon(self, tenant: TenantId, map_id: str, *session_ids: str) -> None:
        """Erase sessions of a map that were marked, or without any the map: returns at the end, or after a while."""
        marked = await self._storage.read(partial(_marked, tenant=tenant, map_id=map_id, ids=session_ids or ("",)))
        if marked:
            await asyncio.wait({self._begun(deletion) for deletion in marked}, timeout=AWAITED_S)

    async def close(self) -> None:
        """Stop where it stands."""
        tasks = list(self._under_way.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _begun(self, deletion: DeletionRecord) -> asyncio.Task[None]:
        """The task that erases it, which may have begun before."""
        task = self._under_way.get(deletion.number)
        if task is None:
            task = asyncio.create_task(self._erase(deletion), name="erasure")
            self._under_way[deletion.number] = task
            task.add_done_callback(lambda _: self._under_way.pop(deletion.number))
        return task

    async def _erase(self, deletion: DeletionRecord) -> None:
        began_s, portions = time.perf_counter(), 0
        try:
            for step in _STEPS:
                while await self._portion(step, deletion):
                    portions += 1
        except RevisitError as error:  # the next round of the chore goes on
            log.warning("erasure_interrupted", map=deletion.map_id, reason=error.reason)
            return
        except Exception:  # a defect must not be silent because nobody waits for the task
            log.exception("erasure_crashed", map=deletion.map_id)
            return
        took_s = round(time.perf_counter() - began_s, 3)
        named = {"map": deletion.map_id, "session": deletion.session_id}
        log.info("erased", tenant=deletion.tenant, **named, portions=portions, took_s=took_s)

    async def _portion(self, step: Step, deletion: DeletionRecord) -> bool:
        """Delete the next rows; whether there were any."""
        async with self._turn:
            began_s = time.perf_counter()
            portion = Portion(self._clock.wall_ns(), self._share)
            found, held_s = await self._storage.write(partial(_timed, step=step, deletion=deletion, portion=portion))
            self._share = next_share(self._share, held_s)
            took_s = time.perf_counter() - began_s
            failpoint("delete.after_rows")
            if found:
                await asyncio.sleep(took_s)
        return found


def next_share(share: float, held_s: float) -> float:
    """The share of the portion after one whose statements took `held_s`: it grows by half at most, and shrinks to a
    quarter at most.
    """
    fitting = min(max(PORTION_S / max(held_s, 1e-6), 0.25), 1.5)
    return min(max(share * fitting, LEAST_SHARE), 1.0)


def _timed(uow: UnitOfWork, step: Step, deletion: DeletionRecord, portion: Portion) -> tuple[bool, float]:
    """Do a step; whether there was something, and how long its statements took, seconds."""
    began_s = _now_s()
    found = step(uow.everything, deletion, portion)
    return found, _now_s() - began_s


def _marked(uow: UnitOfWork, tenant: TenantId, map_id: str, ids: Sequence[str]) -> list[DeletionRecord]:
    found = (uow.deletions.get(tenant, map_id, session_id) for session_id in ids)
    return [deletion for deletion in found if deletion is not None]


def _submaps(uow: UnitOfWork, deletion: DeletionRecord, portion: Portion) -> bool:
    """Submaps with their loop closures, which go first; their jobs end."""
    tenant, rows = deletion.tenant, portion.most(ROWS)
    submaps = uow.submaps.some(tenant, portion.most(SUBMAPS), **_of(deletion))
    if not submaps:
        return False
    numbers = [submap.number for submap in submaps]
    for loops in (uow.loops, uow.loop_events):
        for end in ("query_number", "match_number"):
            if loops.delete_some(tenant, rows, end, numbers) == rows:
                return True
    drop_jobs(uow, submaps, portion.at_ns)
    uow.submaps.delete_some(tenant, len(numbers), "number", numbers)
    uow.blobs.release(tenant, {blob for submap in submaps for blob in blobs_of_submap(submap)})
    return True


def _scans(uow: UnitOfWork, deletion: DeletionRecord, portion: Portion) -> bool:
    scans = _without(uow.scans, deletion, portion.most(ROWS))
    uow.blobs.release(deletion.tenant, blobs_of_scans(scans))
    return bool(scans)


def _anchors(uow: UnitOfWork, deletion: DeletionRecord, portion: Portion) -> bool:
    return bool(_without(uow.anchors, deletion, portion.most(ROWS)))


def _radio(uow: UnitOfWork, deletion: DeletionRecord, portion: Portion) -> bool:
    return bool(_without(uow.radio_readings, deletion, portion.most(ROWS)))


def _poses(uow: UnitOfWork, deletion: DeletionRecord, portion: Portion) -> bool:
    gone = _without(uow.session_poses, deletion, portion.most(VERSIONS))
    if deletion.session_id:
        submaps: Counter[int] = Counter()
        for row in gone:
            submaps[row.version] += len(PackedSubmaps.of(row.submaps).numbers)
        forget_in_summaries(uow, TenantId(deletion.tenant), deletion.map_id, submaps)
    return bool(gone)


def _tiles(uow: UnitOfWork, deletion: DeletionRecord, portion: Portion) -> bool:
    tiles = [] if deletion.session_id else _without(uow.map_tiles, deletion, portion.most(ROWS))
    uow.blobs.release(deletion.tenant, {blob_of_tile(tile) for tile in tiles})
    return bool(tiles)


def _files(uow: UnitOfWork, deletion: DeletionRecord, portion: Portion) -> bool:
    files = [] if deletion.session_id else _without(uow.map_files, deletion, portion.most(ROWS))
    uow.blobs.release(deletion.tenant, {blob_of_file(file) for file in files})
    return bool(files)


def _plans(uow: UnitOfWork, deletion: DeletionRecord, portion: Portion) -> bool:
    plans = [] if deletion.session_id else _without(uow.plans, deletion, portion.most(ROWS))
    uow.blobs.release(deletion.tenant, {blob_of_plan(plan) for plan in plans})
    return bool(plans)


def _versions(uow: UnitOfWork, deletion: DeletionRecord, portion: Portion) -> bool:
    gone = [] if deletion.session_id else _without(uow.map_versions, deletion, portion.most(VERSIONS))
    return bool(gone)


def _sessions(uow: UnitOfWork, deletion: DeletionRecord, portion: Portion) -> bool:
    """Sessions themselves, empty by now; with those of a map the corrections ahead of its versions."""
    uow.early_corrections.delete(deletion.tenant, **_of(deletion))
    return bool(_without(uow.sessions, deletion, portion.most(ROWS)))


def _mark(uow: UnitOfWork, deletion: DeletionRecord, _: Portion) -> bool:
    """The map itself, if it goes, and the mark: from now on the id is free again."""
    tenant, of_map = deletion.tenant, {"map_id": deletion.map_id}
    if deletion.session_id:
        uow.deletions.delete(tenant, number=deletion.number)
        return False
    for rows in (uow.map_merges, uow.maps, uow.deletions):
        rows.delete(tenant, **of_map)
    return False


_STEPS: tuple[Step, ...] = (
    *(_submaps, _scans, _anchors, _radio, _poses, _tiles, _files, _plans, _versions, _sessions, _mark),
)
"""In an order that leaves no row without its parent."""


def _of(deletion: DeletionRecord) -> dict[str, str]:
    """The condition of the rows of a deletion."""
    of_session = {"session_id": deletion.session_id} if deletion.session_id else {}
    return {"map_id": deletion.map_id, **of_session}


def _without(rows: Repository[R], deletion: DeletionRecord, limit: int) -> list[R]:
    """Delete and return a portion of the rows of a deletion."""
    some = rows.some(deletion.tenant, limit, **_of(deletion))
    numbers = [row.number for row in some]
    if numbers:
        rows.delete_some(deletion.tenant, limit, "number", numbers)
    return some
