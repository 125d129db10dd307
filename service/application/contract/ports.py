"""What the use cases need from outside, each with its contract. tests/contract runs every implementation."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import PipelineConfig
from revisit.core.geometry.se3 import Matrix4
from revisit.core.submap import Submap
from revisit.service.application.contract.access_ports import AuditTrail, KeyRing
from revisit.service.application.contract.identity import TenantId
from revisit.service.application.contract.records import (
    JobRecord,
    LoopRecord,
    MapRecord,
    RobotRecord,
    ScanRecord,
    SessionRecord,
    SubmapRecord,
    WorkerRecord,
)

R = TypeVar("R")
T = TypeVar("T")


@dataclass(frozen=True)
class Instant:
    """A moment on the monotonic clock: `ms` counts within one `epoch` (boot); other epochs are always in the past."""

    epoch: str
    ms: int


class Clock(Protocol):
    """Time. Wall time labels things; only the monotonic clock decides anything."""

    def wall_ns(self) -> int:
        """Nanoseconds since 1970, UTC."""
        ...

    def instant(self) -> Instant:
        """Now, the same for all processes of this machine."""
        ...


class Repository(Protocol[R]):
    """Records of one kind. The tenant is part of every key and query."""

    def add(self, record: R) -> R:
        """Store a new record and return it with its number. Raises AlreadyExists where its key is taken."""
        ...

    def get(self, tenant: TenantId, *key: str | int) -> R | None:
        """The record with this key, or None."""
        ...

    def find(
        self, tenant: TenantId, *, after: int = 0, limit: int | None = None, **equals: str | int | None
    ) -> list[R]:
        """Records whose fields equal `equals` and whose number is above `after`, by number, at most `limit`."""
        ...

    def numbered(self, tenant: TenantId, numbers: Sequence[int]) -> dict[int, R]:
        """The records of this tenant with these numbers (at most 1000), by number; missing ones are left out."""
        ...

    def distinct(self, tenant: TenantId, field: str, **equals: str | int | None) -> set[Any]:
        """The values that a field has in the records that `find` would give; without None."""
        ...

    def count(self, tenant: TenantId, **equals: str | int | None) -> int:
        """How many records `find` would give."""
        ...

    def count_of_all_tenants(self, **equals: str | int | None) -> int:
        """How many records all tenants have together, for those who look after the service."""
        ...

    def of_all_tenants(self, *, after: int = 0, limit: int | None = None) -> list[R]:
        """As `find`, of every tenant, for those who look after the service."""
        ...

    def replace(self, record: R) -> None:
        """Overwrite the record of this number. Raises NotFound where there is none."""
        ...

    def delete(self, tenant: TenantId, **equals: str | int | None) -> int:
        """Delete what `find` would give; how many."""
        ...


class ScanRepository(Repository[ScanRecord], Protocol):
    """Scans, also by distance travelled and by range of sequence numbers."""

    def first_seq_from(self, tenant: TenantId, map_id: str, session_id: str, travelled_m: float) -> int | None:
        """The first scan of a session taken at or beyond `travelled_m`."""
        ...

    def with_seqs(self, tenant: TenantId, map_id: str, session_id: str, seqs: Sequence[int]) -> list[ScanRecord]:
        """Those scans of a session that have one of these numbers, in order."""
        ...


class SubmapRepository(Repository[SubmapRecord], Protocol):
    """Submaps, also by how far a map has come with them."""

    def last_number(self) -> int:
        """The last number that was given out, to whichever tenant, deleted since or not; 0 for none."""
        ...

    def waiting_up_to(self, tenant: TenantId, map_id: str, number: int) -> int:
        """How many submaps of a map with numbers up to `number` are still queued."""
        ...


class JobRepository(Repository[JobRecord], Protocol):
    """Jobs, also across tenants for those who run them."""

    def next_runnable(self, now: Instant, after: str = "") -> JobRecord | None:
        """A job that is queued and due, or whose lease has run out with attempts left: the most urgent, then oldest.

        Tenants take turns: it is of the first tenant behind `after`, by name, that has one; behind the last comes the
        first.
        """
        ...

    def exhausted(self, now: Instant) -> list[JobRecord]:
        """Jobs running on a lease that has run out, with no attempts left."""
        ...

    def leased_to(self, owner: str) -> list[JobRecord]:
        """The running jobs of a worker."""
        ...

    def forget_answers(self, before_ns: int, limit: int) -> int:
        """Delete the first `limit` queries (jobs of priority 0), of all tenants, that ended before then; how many."""
        ...

    def oldest_queued_ns(self) -> int | None:
        """When the longest waiting job of any tenant was made, nanoseconds since 1970; None where none waits."""
        ...


@dataclass(frozen=True)
class Lease:
    """The right to run a job until it runs out; `job.lease_token` is the fencing token."""

    job: JobRecord


class JobQueue(Protocol):
    """Jobs in the same transaction as the rows they belong to; at least one run, at most one effect."""

    def enqueue(self, job: JobRecord) -> JobRecord:
        """Queue a job."""
        ...

    def claim(self, owner: str, now: Instant, after: str = "") -> Lease | None:
        """Lease the next runnable job behind tenant `after` to `owner`; the attempt is counted before the run."""
        ...

    def require(self, lease: Lease) -> None:
        """Raises StaleLease where another worker holds the job by now."""
        ...

    def extend(self, lease: Lease, now: Instant) -> None:
        """Keep the lease. Raises StaleLease where another worker holds the job by now."""
        ...

    def complete(self, lease: Lease, result: dict[str, Any], finished_at_ns: int) -> None:
        """End the job well. Raises StaleLease."""
        ...

    def fail(self, lease: Lease, code: str, message: str, now: Instant, finished_at_ns: int, *, retry: bool) -> bool:
        """Count a failed run: back to the queue while `retry` and attempts are left. Whether it failed for good."""
        ...

    def bury(self, now: Instant, finished_at_ns: int) -> list[JobRecord]:
        """Fail the jobs whose last allowed run ended with its worker; returns them."""
        ...

    def release(self, owner: str, now: Instant, reason: str) -> int:
        """End the runs of a worker that died of `reason`, without waiting for its leases to run out; how many."""
        ...


@dataclass(frozen=True)
class IndexChange:
    """A submap entered (`vector` given) or left a map's index. `seq` grows in the order of commits."""

    seq: int
    submap_number: int
    session_number: int
    ordinal: int
    position_m: tuple[float, float, float]
    vector: bytes | None


class ChangeLog(Protocol):
    """The history of a map's index, which lets any process catch up: the database is the truth, an index a cache."""

    def record_described(self, tenant: TenantId, map_number: int, submap_number: int) -> int:
        """The submap has a descriptor now; the change's sequence number."""
        ...

    def record_removed(self, tenant: TenantId, map_number: int, submap_numbers: Collection[int]) -> None:
        """The submaps are gone; a change for each."""
        ...

    def since(self, tenant: TenantId, map_number: int, seq: int, limit: int | None = None) -> list[IndexChange]:
        """The changes above `seq` in order, the first `limit` of them.

        A submap that has gone meanwhile appears only as removed.
        """
        ...


class WorkerLog(Protocol):
    """Which worker processes live."""

    def beat(self, worker: WorkerRecord) -> None:
        """The worker shows itself."""
        ...

    def alive(self, epoch: str, since_ms: int) -> list[WorkerRecord]:
        """Workers seen at or after `since_ms` of `epoch`, last seen first."""
        ...

    def forget(self, worker_id: str) -> None:
        """The worker is gone."""
        ...


class UnitOfWork(Protocol):
    """One transaction: all of it is committed, or none."""

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
    def loops(self) -> Repository[LoopRecord]:
        """Loop closures by (map_id, loop_id)."""
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
    def changes(self) -> ChangeLog:
        """The change log of the maps' indexes."""
        ...

    @property
    def workers(self) -> WorkerLog:
        """The living workers."""
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
    """Runs units of work: writes one after another, reads beside them on a consistent snapshot."""

    def write(self, work: Callable[[UnitOfWork], T], *, alone: bool = False) -> Future[T]:
        """Run `work` and commit durably before the future is done; an exception rolls back and is passed on.

        Works that wait share a transaction, and so see each other's changes; `alone`, for one that does what a
        rollback cannot undo: it sees committed rows only. Raises through the future: StorageFull, StorageUncertain,
        DataLoss, and what `work` raises.
        """
        ...

    def read(self, work: Callable[[UnitOfWork], T]) -> Future[T]:
        """Run `work` on a snapshot; it must not change anything."""
        ...

    def close(self) -> None:
        """Finish what is queued and release everything."""
        ...


@dataclass(frozen=True)
class StoredBlob:
    """The address of a blob."""

    tenant: TenantId
    kind: str
    sha256: str


class BlobStore(Protocol):
    """Bytes by content, per tenant and kind. What `put` has returned survives a power cut."""

    def put(self, tenant: TenantId, kind: str, data: bytes) -> str:
        """Store durably; the SHA-256 (hex). Again: no effect. Raises StorageFull, StorageUncertain."""
        ...

    def get(self, tenant: TenantId, kind: str, sha256: str) -> bytes:
        """The bytes, checked against their hash. Raises DataLoss where they are damaged or missing."""
        ...

    def exists(self, tenant: TenantId, kind: str, sha256: str) -> bool:
        """Whether the blob is there (its content is not checked)."""
        ...

    def delete(self, tenant: TenantId, kind: str, sha256: str) -> None:
        """Forget the blob; no effect where there is none."""
        ...

    def stored(self, older_than_s: float) -> Iterator[StoredBlob]:
        """Every blob of every tenant that was stored at least so long ago."""
        ...


class DiskSpace(Protocol):
    """Whether there is room for what clients send."""

    def full(self) -> bool:
        """Whether new data must be refused: what room is left is for finishing and for deleting."""
        ...

    def exhausted(self) -> bool:
        """Whether not even that is left."""
        ...

    def wal_bytes(self) -> int:
        """Size of what is committed and not folded back into the database yet."""
        ...


@dataclass(frozen=True)
class VectorFilter:
    """Which submaps may be hits. Sessions and submaps by number.

    `near_session`, `near_ordinal`, `min_gap`: submaps of that session nearer than `min_gap` ordinals are no hits.
    """

    exclude_submap: int | None = None
    exclude_session: int | None = None
    only_session: int | None = None
    near_session: int | None = None
    near_ordinal: int = 0
    min_gap: int = 0
    position_m: tuple[float, float, float] | None = None
    radius_m: float | None = None


@dataclass(frozen=True)
class VectorMatch:
    """A hit: submap number and cosine similarity."""

    submap_number: int
    similarity: float


class VectorIndex(Protocol):
    """Nearest descriptors of one map each, keyed by map number: a cache that catches up with the change log."""

    def seq(self, map_number: int) -> int:
        """The last change applied, 0 for none."""
        ...

    def apply(self, map_number: int, changes: Sequence[IndexChange], after: int = 0) -> None:
        """Apply the changes that follow change `after`, in order; those at or below `seq` are ignored.

        All are where `seq` is below `after`: the map was forgotten since they were read.
        """
        ...

    def search(self, map_number: int, vector: NDArray[np.float32], k: int, where: VectorFilter) -> list[VectorMatch]:
        """The k nearest, most similar first, ties by number. Raises BadField for another dimension or NaN."""
        ...

    def size(self, map_number: int) -> int:
        """How many submaps it holds."""
        ...

    def drop(self, map_number: int) -> None:
        """Forget a map."""
        ...

    def numbers(self, map_number: int) -> tuple[int, NDArray[np.int64]]:
        """`seq`, and the numbers of the submaps that it holds as of that change."""
        ...

    def differing(self, map_number: int, places: Sequence[IndexChange]) -> list[int]:
        """The numbers of those `places`, which have vectors, that it does not hold exactly so."""
        ...


@dataclass(frozen=True)
class Mesh:
    """Triangles: vertices (v, 3) float32 metres in the submap frame, unit normals (v, 3), faces (f, 3) int32."""

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    faces: NDArray[np.int32]


@dataclass(frozen=True)
class SubmapDescription:
    """What a worker learns about a submap. `descriptor` (d,) float32, L2-normalised; blobs are versioned by `core`."""

    descriptor: NDArray[np.float32]
    signature: bytes
    neural_map: bytes | None
    mesh: Mesh
    flags: tuple[str, ...]
    timings_s: dict[str, float]


@dataclass(frozen=True)
class LoopVerdict:
    """Accepted with `T_match_query`, or rejected for `reason`; `evidence` is JSON: what was measured, and the rules."""

    accepted: bool
    reason: str | None
    score: float
    T_match_query: Matrix4 | None
    evidence: dict[str, Any]


class PlaceRecogniser(Protocol):
    """The method, as the workers call it."""

    @property
    def model_version(self) -> str:
        """Descriptors of different versions must not be compared."""
        ...

    def describe(self, submap: Submap, config: PipelineConfig) -> SubmapDescription:
        """Neural map, descriptor and signature of a submap. Raises RevisitError where it cannot be described."""
        ...

    def verify(self, query: bytes, match: bytes, similarity: float, config: PipelineConfig) -> LoopVerdict:
        """Compare two signatures geometrically. Raises DataLoss for damaged ones."""
        ...
