"""Transactions in memory: each works on a copy of all rows, which replaces the original at its end."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from functools import cached_property
from typing import Any, TypeVar

from revisit.service.domain.events import ChangeOf, on_job_change, on_loop_change, on_version_change
from revisit.service.domain.records import (
    AnchorRecord,
    DeletionRecord,
    EarlyCorrectionRecord,
    LoopEventRecord,
    MapFileRecord,
    MapMergeRecord,
    MapTileRecord,
    MapVersionRecord,
    RadioReadingRecord,
    RobotRecord,
    SessionPosesRecord,
    SessionRecord,
)
from revisit.service.domain.webhooks import DeliveryRecord
from revisit.service.engines.fair_turns import FairTurns
from revisit.service.engines.leased_jobs import LeasedJobs
from revisit.service.engines.local.clock import SystemClock
from revisit.service.ports.clock import Clock
from revisit.service.ports.transactions import UnitOfWork
from tests.support.memory.access import MemoryAuditTrail, MemoryKeyRing
from tests.support.memory.blob_rows import MemoryBlobRows
from tests.support.memory.repositories import (
    Doomed,
    MemoryChangeLog,
    MemoryEventLog,
    MemoryJobs,
    MemoryLoops,
    MemoryMaps,
    MemoryPlans,
    MemoryProcessLog,
    MemoryRepository,
    MemoryScans,
    MemorySubmaps,
    MemoryTenantTurns,
    MemoryWebhooks,
    MemoryWorkerLog,
    Rows,
)

R = TypeVar("R")
T = TypeVar("T")

_TABLES = (
    *("maps", "robots", "sessions", "scans", "submaps", "loops"),
    *("loop_events", "map_versions", "session_poses", "early_corrections", "map_merges", "map_tiles", "map_files"),
    *("anchors", "radio_readings", "plans", "deletions"),
    "unreferenced_blobs",
    *("jobs", "turns", "changes", "events", "webhooks", "webhook_deliveries", "workers", "keys", "audit"),
    "processes",
)


class MemoryUnitOfWork:
    """`UnitOfWork` over a copy of every table."""

    def __init__(self, tables: dict[str, Rows], lease_ms: int, clock: Clock, *, sees_all: bool = False) -> None:
        """Changes `tables` in place; `sees_all`: also rows of what is being deleted."""
        self._tables, self._lease_ms, self._clock = tables, lease_ms, clock
        doomed = None if sees_all else Doomed(tables["deletions"])

        def of_map(name: str, *key: str, listener: ChangeOf[R] | None = None) -> MemoryRepository[Any]:
            return MemoryRepository(tables[name], ("map_id", *key), listener, doomed)

        self.maps = MemoryMaps(tables["maps"], ("map_id",), None, doomed)
        self.events = MemoryEventLog(tables["events"], self.maps, tables["loops"])
        self.robots: MemoryRepository[RobotRecord] = MemoryRepository(tables["robots"], ("robot_id",))
        self.sessions: MemoryRepository[SessionRecord] = of_map("sessions", "session_id")
        self.scans = MemoryScans(tables["scans"], ("map_id", "session_id", "seq"), None, doomed)
        self.submaps = MemorySubmaps(tables["submaps"], ("map_id", "session_id", "submap_id"), None, doomed)
        self.loops = MemoryLoops(tables["loops"], ("map_id", "loop_id"), on_loop_change(self.events), doomed)
        self.loop_events: MemoryRepository[LoopEventRecord] = MemoryRepository(
            tables["loop_events"], ("number",), None, doomed
        )
        listener = on_version_change(self.events)
        self.map_versions: MemoryRepository[MapVersionRecord] = of_map("map_versions", "version", listener=listener)
        self.session_poses: MemoryRepository[SessionPosesRecord] = of_map("session_poses", "version", "session_id")
        self.anchors: MemoryRepository[AnchorRecord] = of_map("anchors", "session_id", "anchor_id")
        self.radio_readings: MemoryRepository[RadioReadingRecord] = of_map("radio_readings", "session_id", "stamp_ns")
        self.early_corrections: MemoryRepository[EarlyCorrectionRecord] = of_map("early_corrections", "session_id")
        self.map_merges: MemoryRepository[MapMergeRecord] = of_map("map_merges", "merge_id")
        self.map_tiles: MemoryRepository[MapTileRecord] = of_map("map_tiles", "version", "tile_id")
        self.map_files: MemoryRepository[MapFileRecord] = of_map("map_files", "version")
        self.plans = MemoryPlans(tables["plans"], ("map_id", "plan_id"), None, doomed)
        self.deletions: MemoryRepository[DeletionRecord] = MemoryRepository(
            tables["deletions"], ("map_id", "session_id")
        )
        self.jobs = MemoryJobs(tables["jobs"], ("operation_id",), on_job_change(self.events))
        self.webhooks = MemoryWebhooks(tables["webhooks"], self.maps, self.events)
        self.webhook_deliveries: MemoryRepository[DeliveryRecord] = MemoryRepository(
            tables["webhook_deliveries"], ("number",)
        )
        turns = FairTurns(MemoryTenantTurns(tables["turns"], self.jobs))
        self.queue = LeasedJobs(self.jobs, turns, lease_ms, clock.monotonic_ms, clock)
        self.blobs = MemoryBlobRows(tables["unreferenced_blobs"], tables, clock)
        self.changes = MemoryChangeLog(tables["changes"], tables["submaps"])
        self.workers = MemoryWorkerLog(tables["workers"], clock)
        self.processes = MemoryProcessLog(tables["processes"], clock)
        self.keys = MemoryKeyRing(tables["keys"].by_number)
        self.audit = MemoryAuditTrail(tables["audit"].by_number)

    @cached_property
    def everything(self) -> MemoryUnitOfWork:
        """See `UnitOfWork`."""
        return MemoryUnitOfWork(self._tables, self._lease_ms, self._clock, sees_all=True)


class MemoryTransactions:
    """`Transactions` without a disk: a transaction works on a copy, which replaces the original at the end."""

    def __init__(self, lease_ms: int = 10_000, clock: Clock = SystemClock()) -> None:
        """Begins empty."""
        self._tables = {name: Rows() for name in _TABLES}
        self._lease_ms, self._clock = lease_ms, clock
        self._lock = threading.Lock()
        self._commits = 0

    def write(self, work: Callable[[UnitOfWork], T], *, durable: bool = True) -> Future[T]:
        """See `Transactions`."""
        return _settled(lambda: self._write(work))

    def read(self, work: Callable[[UnitOfWork], T]) -> Future[T]:
        """See `Transactions`."""
        return _settled(lambda: self.read_here(work))

    def read_here(self, work: Callable[[UnitOfWork], T]) -> T:
        """See `Transactions`."""
        with self._lock:
            committed = self._tables  # no transaction changes these: each writes in a copy
        fixed = {name: rows.fixed() for name, rows in committed.items()}
        return work(MemoryUnitOfWork(fixed, self._lease_ms, self._clock))

    def version(self) -> int | None:
        """See `Transactions`."""
        return self._commits

    def close(self) -> None:
        """See `Transactions`."""

    def _write(self, work: Callable[[UnitOfWork], T]) -> T:
        with self._lock:
            tables = self._copy()
            result = work(MemoryUnitOfWork(tables, self._lease_ms, self._clock))
            self._tables = tables
            self._commits += 1
            return result

    def _copy(self) -> dict[str, Rows]:
        return {name: rows.copy() for name, rows in self._tables.items()}


def _settled(work: Callable[[], T]) -> Future[T]:
    future: Future[T] = Future()
    try:
        future.set_result(work())
    except Exception as error:  # noqa: BLE001  # a future carries whatever the work raised
        future.set_exception(error)
    return future
