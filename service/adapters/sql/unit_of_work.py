"""One transaction of an SQL database, as the use cases see it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from sqlalchemy import Connection

from revisit.service.adapters.fair_turns import FairTurns
from revisit.service.adapters.leased_jobs import LeasedJobs
from revisit.service.adapters.sql import tables
from revisit.service.adapters.sql.access import SqlAuditTrail, SqlKeyRing
from revisit.service.adapters.sql.change_log import SqlChangeLog
from revisit.service.adapters.sql.engine import DatabaseEngine
from revisit.service.adapters.sql.event_log import SqlEventLog
from revisit.service.adapters.sql.jobs import SqlJobs
from revisit.service.adapters.sql.repositories import SqlRepository, SqlScans, SqlSubmaps
from revisit.service.adapters.sql.turns import SqlTenantTurns
from revisit.service.adapters.sql.worker_log import SqlWorkerLog
from revisit.service.application.contract.events import on_job_change, on_loop_change, on_version_change
from revisit.service.application.contract.records import (
    EarlyCorrectionRecord,
    JobRecord,
    LoopEventRecord,
    LoopRecord,
    MapFileRecord,
    MapMergeRecord,
    MapRecord,
    MapTileRecord,
    MapVersionRecord,
    RobotRecord,
    ScanRecord,
    SessionPosesRecord,
    SessionRecord,
    SubmapRecord,
)
from revisit.service.application.contract.webhooks import DeliveryRecord, WebhookRecord


@dataclass(frozen=True)
class SqlUnitOfWork:
    """`UnitOfWork` over a connection in one transaction. A lease lasts `lease_ms` milliseconds."""

    connection: Connection
    engine: DatabaseEngine
    lease_ms: int

    @cached_property
    def maps(self) -> SqlRepository[MapRecord]:
        """Maps by (map_id)."""
        return SqlRepository(self.connection, self.engine, tables.maps, MapRecord, ("map_id",))

    @cached_property
    def robots(self) -> SqlRepository[RobotRecord]:
        """Robots by (robot_id)."""
        return SqlRepository(self.connection, self.engine, tables.robots, RobotRecord, ("robot_id",))

    @cached_property
    def sessions(self) -> SqlRepository[SessionRecord]:
        """Sessions by (map_id, session_id)."""
        return SqlRepository(self.connection, self.engine, tables.sessions, SessionRecord, ("map_id", "session_id"))

    @cached_property
    def scans(self) -> SqlScans:
        """Scans by (map_id, session_id, seq)."""
        return SqlScans(self.connection, self.engine, tables.scans, ScanRecord, ("map_id", "session_id", "seq"))

    @cached_property
    def submaps(self) -> SqlSubmaps:
        """Submaps by (map_id, session_id, submap_id)."""
        key = ("map_id", "session_id", "submap_id")
        return SqlSubmaps(self.connection, self.engine, tables.submaps, SubmapRecord, key)

    @cached_property
    def loops(self) -> SqlRepository[LoopRecord]:
        """Loop closures by (map_id, loop_id)."""
        key, told = ("map_id", "loop_id"), on_loop_change(self.events)
        return SqlRepository(self.connection, self.engine, tables.loops, LoopRecord, key, told)

    @cached_property
    def loop_events(self) -> SqlRepository[LoopEventRecord]:
        """Changes of loop closures by (number)."""
        return SqlRepository(self.connection, self.engine, tables.loop_events, LoopEventRecord, ("number",))

    @cached_property
    def map_versions(self) -> SqlRepository[MapVersionRecord]:
        """Versions of maps by (map_id, version)."""
        key, told = ("map_id", "version"), on_version_change(self.events)
        return SqlRepository(self.connection, self.engine, tables.map_versions, MapVersionRecord, key, told)

    @cached_property
    def session_poses(self) -> SqlRepository[SessionPosesRecord]:
        """The poses of sessions in versions of maps by (map_id, version, session_id)."""
        key = ("map_id", "version", "session_id")
        return SqlRepository(self.connection, self.engine, tables.session_poses, SessionPosesRecord, key)

    @cached_property
    def early_corrections(self) -> SqlRepository[EarlyCorrectionRecord]:
        """Corrections ahead of the next version by (map_id, session_id)."""
        key = ("map_id", "session_id")
        return SqlRepository(self.connection, self.engine, tables.early_corrections, EarlyCorrectionRecord, key)

    @cached_property
    def map_merges(self) -> SqlRepository[MapMergeRecord]:
        """Merges into maps by (map_id, merge_id)."""
        key = ("map_id", "merge_id")
        return SqlRepository(self.connection, self.engine, tables.map_merges, MapMergeRecord, key)

    @cached_property
    def map_tiles(self) -> SqlRepository[MapTileRecord]:
        """Tiles of versions of maps by (map_id, version, tile_id)."""
        key = ("map_id", "version", "tile_id")
        return SqlRepository(self.connection, self.engine, tables.map_tiles, MapTileRecord, key)

    @cached_property
    def map_files(self) -> SqlRepository[MapFileRecord]:
        """Versions of maps as files by (map_id, version)."""
        return SqlRepository(self.connection, self.engine, tables.map_files, MapFileRecord, ("map_id", "version"))

    @cached_property
    def jobs(self) -> SqlJobs:
        """Jobs by (operation_id)."""
        told = on_job_change(self.events)
        return SqlJobs(self.connection, self.engine, tables.jobs, JobRecord, ("operation_id",), told)

    @cached_property
    def queue(self) -> LeasedJobs:
        """The job queue in this transaction."""
        return LeasedJobs(self.jobs, FairTurns(SqlTenantTurns(self.connection)), self.lease_ms)

    @cached_property
    def changes(self) -> SqlChangeLog:
        """The change log of the maps' indexes."""
        return SqlChangeLog(self.connection, self.engine)

    @cached_property
    def webhooks(self) -> SqlRepository[WebhookRecord]:
        """Webhooks by (webhook_id)."""
        return SqlRepository(self.connection, self.engine, tables.webhooks, WebhookRecord, ("webhook_id",))

    @cached_property
    def webhook_deliveries(self) -> SqlRepository[DeliveryRecord]:
        """Attempts to deliver by (number)."""
        return SqlRepository(self.connection, self.engine, tables.webhook_deliveries, DeliveryRecord, ("number",))

    @cached_property
    def events(self) -> SqlEventLog:
        """The log of what happens in the maps."""
        return SqlEventLog(self.connection, self.engine)

    @cached_property
    def workers(self) -> SqlWorkerLog:
        """The living workers."""
        return SqlWorkerLog(self.connection)

    @cached_property
    def keys(self) -> SqlKeyRing:
        """API keys."""
        return SqlKeyRing(self.connection)

    @cached_property
    def audit(self) -> SqlAuditTrail:
        """The audit log."""
        return SqlAuditTrail(self.connection, self.engine)
