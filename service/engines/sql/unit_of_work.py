"""One transaction of an SQL database, as the use cases see it: which records lie in which table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, TypeVar

from sqlalchemy import Connection, Table

from revisit.service.domain.events import (
    ChangeOf,
    EventLog,
    on_job_change,
    on_loop_change,
    on_version_change,
)
from revisit.service.domain.records import (
    AnchorRecord,
    DeletionRecord,
    EarlyCorrectionRecord,
    JobRecord,
    LoopEventRecord,
    LoopRecord,
    MapFileRecord,
    MapMergeRecord,
    MapRecord,
    MapTileRecord,
    MapVersionRecord,
    PlanRecord,
    RadioReadingRecord,
    RobotRecord,
    ScanRecord,
    SessionPosesRecord,
    SessionRecord,
    SubmapRecord,
)
from revisit.service.domain.webhooks import DeliveryRecord, WebhookRecord
from revisit.service.engines.fair_turns import FairTurns
from revisit.service.engines.leased_jobs import LeasedJobs
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.access import SqlAuditTrail, SqlKeyRing
from revisit.service.engines.sql.blob_rows import SqlBlobRows
from revisit.service.engines.sql.change_log import SqlChangeLog
from revisit.service.engines.sql.engine import DatabaseEngine
from revisit.service.engines.sql.event_log import SqlEventLog
from revisit.service.engines.sql.jobs import SqlJobs
from revisit.service.engines.sql.loops import SqlLoops
from revisit.service.engines.sql.map_counters import SqlMaps
from revisit.service.engines.sql.process_log import SqlProcessLog
from revisit.service.engines.sql.repositories import SqlPlans, SqlRepository, SqlScans, SqlSubmaps
from revisit.service.engines.sql.turns import SqlTenantTurns
from revisit.service.engines.sql.webhooks import SqlWebhooks
from revisit.service.engines.sql.worker_log import SqlWorkerLog
from revisit.service.ports.clock import Clock

R = TypeVar("R")
Kind = TypeVar("Kind", bound=SqlRepository[Any])


class Stored(Generic[Kind]):
    """An attribute of a unit of work: the repository of a table, made when it is first asked for."""

    def __init__(
        self, kind: Callable[..., Kind], table: Table, record: type, listener: Callable[[EventLog], Any] | None = None
    ) -> None:
        """`told` gives the listener that notes each add and replace as an event."""
        self._kind = kind
        self._table = table
        self._record = record
        self._listener = listener

    def __set_name__(self, owner: type, name: str) -> None:
        """The attribute's name."""
        self._name = name

    def __get__(self, work: SqlUnitOfWork, owner: type) -> Kind:
        """The repository; from now on it is found in the unit of work itself."""
        on_change = None if self._listener is None else self._listener(work.events)
        made = self._kind(work.connection, work.engine, self._table, self._record, on_change, sees_all=work.sees_all)
        vars(work)[self._name] = made
        return made


def stored(
    table: Table, record: type[R], listener: Callable[[EventLog], ChangeOf[R]] | None = None
) -> Stored[SqlRepository[R]]:
    """A table that no use case asks more of than `Repository` can do."""
    return Stored(SqlRepository, table, record, listener)


@dataclass(frozen=True)
class SqlUnitOfWork:
    """`UnitOfWork` over a connection in one transaction. A lease lasts `lease_ms` milliseconds of the store's clock;
    `clock` gives labels.
    """

    connection: Connection
    engine: DatabaseEngine
    lease_ms: int
    clock: Clock
    sees_all: bool = False
    """Whether rows under deletion are visible."""

    maps = Stored(SqlMaps, tables.maps, MapRecord)
    """Maps by (map_id)."""
    robots = stored(tables.robots, RobotRecord)
    """Robots by (robot_id)."""
    sessions = stored(tables.sessions, SessionRecord)
    """Sessions by (map_id, session_id)."""
    scans = Stored(SqlScans, tables.scans, ScanRecord)
    """Scans by (map_id, session_id, seq)."""
    submaps = Stored(SqlSubmaps, tables.submaps, SubmapRecord)
    """Submaps by (map_id, session_id, submap_id)."""
    loops = Stored(SqlLoops, tables.loops, LoopRecord, on_loop_change)
    """Loop closures by (map_id, loop_id)."""
    loop_events = stored(tables.loop_events, LoopEventRecord)
    """Changes of loop closures by (number)."""
    map_versions = stored(tables.map_versions, MapVersionRecord, on_version_change)
    """Versions of maps by (map_id, version)."""
    session_poses = stored(tables.session_poses, SessionPosesRecord)
    """The poses of sessions in versions of maps by (map_id, version, session_id)."""
    anchors = stored(tables.anchors, AnchorRecord)
    """Anchors of sessions by (map_id, session_id, anchor_id)."""
    radio_readings = stored(tables.radio_readings, RadioReadingRecord)
    """Readings of radio by (map_id, session_id, stamp_ns)."""
    early_corrections = stored(tables.early_corrections, EarlyCorrectionRecord)
    """Corrections ahead of the next version by (map_id, session_id)."""
    deletions = stored(tables.deletions, DeletionRecord)
    """Resources under deletion by (map_id, session_id)."""
    map_merges = stored(tables.map_merges, MapMergeRecord)
    """Merges into maps by (map_id, merge_id)."""
    map_tiles = stored(tables.map_tiles, MapTileRecord)
    """Tiles of versions of maps that were made, by (map_id, version, tile_id)."""
    map_files = stored(tables.map_files, MapFileRecord)
    """Versions of maps as files by (map_id, version)."""
    plans = Stored(SqlPlans, tables.plans, PlanRecord)
    """Pictures underneath maps by (map_id, plan_id)."""
    jobs = Stored(SqlJobs, tables.jobs, JobRecord, on_job_change)
    """Jobs by (operation_id)."""
    webhooks = Stored(SqlWebhooks, tables.webhooks, WebhookRecord)
    """Webhooks by (webhook_id)."""
    webhook_deliveries = stored(tables.webhook_deliveries, DeliveryRecord)
    """Attempts to deliver by (number)."""

    @cached_property
    def everything(self) -> SqlUnitOfWork:
        """The same transaction, with rows under deletion visible, too."""
        return replace(self, sees_all=True)

    def now_ms(self) -> int:
        """The time of the store, as it was when this transaction first asked for it."""
        return self._now_ms

    @cached_property
    def _now_ms(self) -> int:
        return self.engine.now_ms(self.connection)

    @cached_property
    def queue(self) -> LeasedJobs:
        """The job queue in this transaction."""
        turns = FairTurns(SqlTenantTurns(self.connection, self.engine))
        return LeasedJobs(self.jobs, turns, self.lease_ms, self.now_ms, self.clock)

    @cached_property
    def blobs(self) -> SqlBlobRows:
        """References to blobs and their collection."""
        return SqlBlobRows(self.connection, self.now_ms)

    @cached_property
    def changes(self) -> SqlChangeLog:
        """The change log of the maps' indexes."""
        return SqlChangeLog(self.connection)

    @cached_property
    def events(self) -> SqlEventLog:
        """The event log of the maps."""
        return SqlEventLog(self.connection)

    @cached_property
    def workers(self) -> SqlWorkerLog:
        """The living workers."""
        return SqlWorkerLog(self.connection, self.engine, self.now_ms)

    @cached_property
    def processes(self) -> SqlProcessLog:
        """The living gateways and search processes."""
        return SqlProcessLog(self.connection, self.engine)

    @cached_property
    def keys(self) -> SqlKeyRing:
        """API keys."""
        return SqlKeyRing(self.connection)

    @cached_property
    def audit(self) -> SqlAuditTrail:
        """The audit log."""
        return SqlAuditTrail(self.connection, self.engine)
