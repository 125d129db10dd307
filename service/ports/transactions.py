"""Transactions: units of work over the repositories."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Protocol, TypeVar

from revisit.service.domain.events import EventLog
from revisit.service.domain.records import (
    AnchorRecord,
    DeletionRecord,
    EarlyCorrectionRecord,
    LoopEventRecord,
    MapFileRecord,
    MapMergeRecord,
    MapRecord,
    MapTileRecord,
    MapVersionRecord,
    RadioReadingRecord,
    RobotRecord,
    SessionPosesRecord,
    SessionRecord,
)
from revisit.service.domain.webhooks import DeliveryRecord
from revisit.service.ports.access import AuditTrail, KeyRing
from revisit.service.ports.blobs import BlobRows
from revisit.service.ports.index import ChangeLog
from revisit.service.ports.job_queue import JobQueue, WorkerLog
from revisit.service.ports.processes import ProcessLog
from revisit.service.ports.repositories import (
    JobRepository,
    LoopRepository,
    PlanRepository,
    Repository,
    ScanRepository,
    SubmapRepository,
    WebhookRepository,
)

T = TypeVar("T")


class UnitOfWork(Protocol):
    """One transaction: all of it is committed, or none.

    No methods, and one property for each kind of record, so that a transaction can change any of them.
    """

    @property
    def maps(self) -> Repository[MapRecord]:
        """Maps by (map_id)."""
        ...

    @property
    def robots(self) -> Repository[RobotRecord]:
        """Robots by (robot_id)."""
        ...

    @property
    def sessions(self) -> Repository[SessionRecord]:
        """Sessions by (map_id, session_id)."""
        ...

    @property
    def scans(self) -> ScanRepository:
        """Scans by (map_id, session_id, seq)."""
        ...

    @property
    def submaps(self) -> SubmapRepository:
        """Submaps by (map_id, session_id, submap_id)."""
        ...

    @property
    def loops(self) -> LoopRepository:
        """Loop closures by (map_id, loop_id)."""
        ...

    @property
    def loop_events(self) -> Repository[LoopEventRecord]:
        """Changes of loop closures by (number)."""
        ...

    @property
    def map_versions(self) -> Repository[MapVersionRecord]:
        """Versions of maps by (map_id, version)."""
        ...

    @property
    def session_poses(self) -> Repository[SessionPosesRecord]:
        """The poses of sessions in versions of maps by (map_id, version, session_id)."""
        ...

    @property
    def anchors(self) -> Repository[AnchorRecord]:
        """Anchors of sessions by (map_id, session_id, anchor_id)."""
        ...

    @property
    def radio_readings(self) -> Repository[RadioReadingRecord]:
        """Readings of radio by (map_id, session_id, stamp_ns)."""
        ...

    @property
    def early_corrections(self) -> Repository[EarlyCorrectionRecord]:
        """Corrections ahead of the next version by (map_id, session_id)."""
        ...

    @property
    def deletions(self) -> Repository[DeletionRecord]:
        """Resources under deletion by (map_id, session_id): hidden maps and sessions."""
        ...

    @property
    def everything(self) -> UnitOfWork:
        """The same transaction, with rows under deletion visible, too."""
        ...

    @property
    def map_merges(self) -> Repository[MapMergeRecord]:
        """Merges into maps by (map_id, merge_id)."""
        ...

    @property
    def map_tiles(self) -> Repository[MapTileRecord]:
        """Tiles of versions of maps that were made, by (map_id, version, tile_id)."""
        ...

    @property
    def map_files(self) -> Repository[MapFileRecord]:
        """Versions of maps as files by (map_id, version)."""
        ...

    @property
    def plans(self) -> PlanRepository:
        """Pictures underneath maps by (map_id, plan_id)."""
        ...

    @property
    def jobs(self) -> JobRepository:
        """Jobs by (operation_id)."""
        ...

    @property
    def queue(self) -> JobQueue:
        """The job queue."""
        ...

    @property
    def blobs(self) -> BlobRows:
        """References to blobs and their collection."""
        ...

    @property
    def changes(self) -> ChangeLog:
        """The change log of the maps' indexes."""
        ...

    @property
    def events(self) -> EventLog:
        """The event log of the maps."""
        ...

    @property
    def webhooks(self) -> WebhookRepository:
        """Webhooks by (webhook_id)."""
        ...

    @property
    def webhook_deliveries(self) -> Repository[DeliveryRecord]:
        """Attempts to deliver by (number)."""
        ...

    @property
    def workers(self) -> WorkerLog:
        """The living workers."""
        ...

    @property
    def processes(self) -> ProcessLog:
        """The living gateways and search processes."""
        ...

    @property
    def keys(self) -> KeyRing:
        """API keys."""
        ...

    @property
    def audit(self) -> AuditTrail:
        """The audit log."""
        ...


class Transactions(Protocol):
    """Runs units of work: those of a process write one after another, reads beside them on a consistent snapshot.

    Where several processes write at the same time, what `work` reads may change before it commits, but for the records
    that it holds (`RowReader.get`).
    """

    def write(self, work: Callable[[UnitOfWork], T], *, durable: bool = True) -> Future[T]:
        """Run `work` and commit durably before the future is done; an exception rolls back and is passed on.

        Writes that wait at the same time share a transaction and see each other's changes: `work` has no effects beyond
        a rollback. One that is not `durable` need not survive a power cut. Where another process is in the way, `work`
        is undone and runs again. Raises through the future: StorageFull, StorageUncertain, DataLoss, and the errors of
        `work`.
        """
        ...

    def read(self, work: Callable[[UnitOfWork], T]) -> Future[T]:
        """Run `work` on a snapshot; it must not change anything."""
        ...

    def read_here(self, work: Callable[[UnitOfWork], T]) -> T:
        """As `read`, in the calling thread, which it blocks: never called on the event loop."""
        ...

    def version(self) -> int | None:
        """A number that is another one once anything was committed, by whichever process; None where it is not known.

        Rows that were read after this number still hold while it is the same. Takes microseconds and
        waits for nobody: may be called on the event loop.
        """
        ...

    def close(self) -> None:
        """Finish the queued work and release everything."""
        ...
