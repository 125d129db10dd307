"""Repositories: the rows of each record, by tenant."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from revisit.service.domain.identity import SubmapKey, TenantId
from revisit.service.domain.records import JobRecord, LoopRecord, PlanRecord, Pose, ScanRecord, SubmapRecord
from revisit.service.domain.webhooks import News, WebhookRecord

R = TypeVar("R")


class RowReader(Protocol[R]):
    """Reads records of one kind. The tenant is part of every query."""

    def get(self, tenant: TenantId, *key: str | int, hold: bool = False) -> R | None:
        """The record with this key, or None. `hold`: until this transaction ends nobody else changes or holds it.

        A use case that changes a record, or what hangs on it, holds it first: in the order map, session, job, submap.
        """
        ...

    def find(
        self, tenant: TenantId, *, after: int = 0, limit: int | None = None, **equals: str | int | None
    ) -> list[R]:
        """Records with fields equal to `equals` and a number above `after`, by number, at most `limit`."""
        ...

    def numbered(self, tenant: TenantId, numbers: Sequence[int], *, hold: bool = False) -> dict[int, R]:
        """The records of this tenant with these numbers (at most 1000), by number; missing ones are left out. `hold` as
        in `get`, one after the other.
        """
        ...

    def distinct(self, tenant: TenantId, field: str, **equals: str | int | None) -> set[Any]:
        """The values that a field has in the records that `find` would give; without None."""
        ...

    def count(self, tenant: TenantId, **equals: str | int | None) -> int:
        """How many records `find` would give."""
        ...

    def damaged(self, tenant: TenantId, **equals: str | int | None) -> list[int]:
        """The numbers of records that `find` would give, whose rows are not as they were written; none where the store
        keeps no checksums of rows.
        """
        ...


class RowWriter(Protocol[R]):
    """Adds, changes and deletes records of one kind."""

    def add(self, record: R) -> R:
        """Store a new record and return it with its number. Raises AlreadyExists where its key is taken."""
        ...

    def add_all(self, records: Sequence[R]) -> None:
        """Store new records in few statements, without telling their numbers. Raises AlreadyExists."""
        ...

    def replace(self, record: R) -> None:
        """Overwrite the record of this number. Raises NotFound where there is none."""
        ...

    def replace_all(self, records: Sequence[R]) -> None:
        """As `replace`, for many records in one statement, of a kind whose changes are no events."""
        ...

    def revise(self, records: Sequence[R], **fields: str | int | None) -> None:
        """Give records of one tenant, told by their numbers, the same values of some fields, in few statements.

        Other fields keep their stored values. Raises NotFound where one is gone.
        """
        ...

    def delete(self, tenant: TenantId, **equals: str | int | None) -> int:
        """Delete the records that `find` would give in `UnitOfWork.everything`; their number."""
        ...


class RowEraser(Protocol[R]):
    """Deletes many records of one kind, a portion at a time."""

    def some(self, tenant: TenantId, limit: int, **equals: str | int | None) -> list[R]:
        """At most `limit` of the records that `find` would give, in any order: the time does not grow with their
        number.
        """
        ...

    def delete_some(self, tenant: TenantId, limit: int, field: str, values: Sequence[str | int]) -> int:
        """Delete at most `limit` of the records, visible or not, with one of `values` in `field`; their number."""
        ...


class RowsOfAllTenants(Protocol[R]):
    """Reads records of one kind across tenants, for the upkeep of the service; no answer to a client rests on it."""

    def count_of_all_tenants(self, **equals: str | int | None) -> int:
        """The number of records of all tenants together, for the service's upkeep."""
        ...

    def of_all_tenants(self, *, after: int = 0, limit: int | None = None) -> list[R]:
        """As `find`, of every tenant, for the service's upkeep."""
        ...


class Repository(RowReader[R], RowWriter[R], RowEraser[R], RowsOfAllTenants[R], Protocol[R]):
    """Records of one kind. The tenant is part of every key."""


class ScanRepository(Repository[ScanRecord], Protocol):
    """Scans, also by distance travelled and by range of sequence numbers."""

    def first_seq_from(self, tenant: TenantId, map_id: str, session_id: str, travelled_m: float) -> int | None:
        """The first scan of a session taken at or beyond `travelled_m`."""
        ...

    def chosen_between(
        self, tenant: TenantId, map_id: str, session_id: str, first: int, last: int, newest: int | None = None
    ) -> list[ScanRecord]:
        """The chosen scans of a session with numbers from `first` to `last`, in order; at most the `newest` of them."""
        ...

    def around(self, tenant: TenantId, map_id: str, session_id: str, stamp_ns: int, limit: int) -> list[ScanRecord]:
        """The scans of a session from the last one up to `stamp_ns` on, or else from its first one, at most `limit`."""
        ...

    def points_of(self, tenant: TenantId) -> int:
        """How many points the clouds of a tenant's scans have together."""
        ...

    def with_seqs(self, tenant: TenantId, map_id: str, session_id: str, seqs: Sequence[int]) -> list[ScanRecord]:
        """Those scans of a session that have one of these numbers, in order."""
        ...


class PlanRepository(Repository[PlanRecord], Protocol):
    """Pictures underneath maps, and how much they take."""

    def bytes_of(self, tenant: TenantId) -> int:
        """How many bytes the pictures of a tenant have together."""
        ...


@dataclass(frozen=True)
class PlacedSubmap:
    """Number of a submap, number of its session, place in the order of the drive, pose in the odometry frame, time."""

    number: int
    session_number: int
    ordinal: int
    T_odom_submap: Pose
    stamp_ns: int


@dataclass(frozen=True)
class PathPoint:
    """A submap of a drive: its number, its place in the order of the drive, its position in the odometry frame."""

    number: int
    ordinal: int
    position_m: tuple[float, float, float]


@dataclass(frozen=True)
class FoundSubmap:
    """A submap as a search result: its number and names, and its position in the odometry frame of its session."""

    number: int
    map_id: str
    session_id: str
    submap_id: str
    position_m: tuple[float, float, float]

    @property
    def key(self) -> SubmapKey:
        """The key of the submap."""
        return SubmapKey(self.map_id, self.session_id, self.submap_id)


@dataclass(frozen=True)
class SubmapStanding:
    """A submap as retention looks at it: its scans `first_seq`..`last_seq` (None for a posted cloud), how far it has
    come, which scans it keeps, when it was taken, and what speaks for it.
    """

    number: int
    session_id: str
    state: str
    first_seq: int | None
    last_seq: int | None
    kept_scans: str
    created_at_ns: int
    described_at_ns: int | None
    point_count: int
    flags: tuple[str, ...]
    searched: bool
    session_number: int
    stamp_ns: int


class FoundSubmaps(Protocol):
    """Submaps as a search tells of them."""

    def found(self, tenant: TenantId, numbers: Sequence[int]) -> dict[int, FoundSubmap]:
        """As `numbered`, as much of the submaps as a search tells."""
        ...


class SubmapRepository(Repository[SubmapRecord], FoundSubmaps, Protocol):
    """Submaps, also by how far a map has come with them."""

    def last_seq(self, tenant: TenantId, map_id: str) -> int:
        """The last `seq` that a submap of the map was given, deleted since or not; 0 for none."""
        ...

    def points_of(self, tenant: TenantId) -> int:
        """How many points the clouds have together that a tenant has posted as submaps."""
        ...

    def placed(self, tenant: TenantId, map_id: str, after: int = 0) -> list[PlacedSubmap]:
        """Every submap of a map with a `seq` above `after`, with its position in its session: by session and then in
        the order of the drive.
        """
        ...

    def path(
        self, tenant: TenantId, map_id: str, session_id: str, ordinal: int, limit: int, *, back: bool = False
    ) -> list[PathPoint]:
        """The next `limit` submaps of a session behind place `ordinal`, or, with `back`, before it: nearest first."""
        ...

    def standings(self, tenant: TenantId, map_id: str, session_id: str | None = None) -> list[SubmapStanding]:
        """The submaps of a map, or of one of its sessions, by number, without descriptors and names."""
        ...

    def first_waiting(self, tenant: TenantId, map_id: str) -> int | None:
        """The lowest `seq` of a submap of a map that is still queued; None where none is."""
        ...

    def first_unsearched(self, tenant: TenantId, map_id: str) -> int | None:
        """As `first_waiting`, of those that are described, with loops that are still searched for."""
        ...

    def flag_counts(self, tenant: TenantId, map_id: str, session_id: str) -> dict[str, int]:
        """Flag -> how many submaps of a session have it; of failed ones also the code of the failure."""
        ...


@dataclass(frozen=True)
class LoopEnds:
    """Number of a loop, and numbers and sessions of its two submaps."""

    number: int
    query_number: int
    query_session_id: str
    match_number: int
    match_session_id: str


class LoopRepository(Repository[LoopRecord], Protocol):
    """Loop closures, also those of several submaps, and in the order in which they were accepted."""

    def accepted(
        self, tenant: TenantId, map_id: str, *, after: int = 0, limit: int | None = None, **equals: str | int | None
    ) -> list[LoopRecord]:
        """The accepted loops of a map with a `seq` above `after` and fields equal to `equals`, by `seq`, at most
        `limit`. The commits give these numbers, so whoever has seen one misses no lower one.
        """
        ...

    def measured(self, tenant: TenantId, map_id: str, *, after: int, limit: int) -> list[LoopRecord]:
        """The next `limit` accepted loops of a map numbered above `after`, in their order; of their evidence only the
        measured covariance can be relied on.
        """
        ...

    def telling(self, tenant: TenantId, query_numbers: Sequence[int], reasons: Sequence[str]) -> list[LoopRecord]:
        """Those of these queries (at most 1000) that were accepted, or have one of `reasons`: by query and number."""
        ...

    def rejected(
        self, tenant: TenantId, map_id: str, reasons: Sequence[str], *, after: int, limit: int
    ) -> list[LoopEnds]:
        """The ends of the next `limit` loops of a map numbered above `after` that were rejected for one of `reasons`,
        by no person: in the order of their numbers.
        """
        ...

    def reasons(self, tenant: TenantId, numbers: Sequence[int]) -> dict[str | None, int]:
        """Reason -> how many loops have it that one of these submaps (at most 500) is in; None of accepted ones."""
        ...


class AwaitedJobs(Repository[JobRecord], Protocol):
    """Jobs that clients wait for."""

    def unfinished(self, tenant: TenantId, operation_ids: Collection[str]) -> frozenset[str]:
        """Those of these operations that wait or run."""
        ...


@dataclass(frozen=True)
class Waiting:
    """How long jobs wait, and how many were begun in vain."""

    oldest_queued_ns: int | None
    """When the longest waiting job was made, nanoseconds since 1970; None where none waits."""
    begun_again: int
    """Jobs that wait or run after a lost run."""


class JobRepository(AwaitedJobs, Protocol):
    """Jobs, also across tenants for upkeep."""

    def forget_answers(self, before_ns: int, limit: int) -> int:
        """Delete the first `limit` queries (jobs of priority 0), of all tenants, that ended before then; how many."""
        ...

    def waiting(self) -> Waiting:
        """The jobs of all tenants that have not ended."""
        ...


class WebhookRepository(Repository[WebhookRecord], Protocol):
    """Webhooks, each with a position in every map that it is told of: the number of the last event that was told."""

    def add(self, record: WebhookRecord) -> WebhookRecord:
        """See `RowWriter`; it stands behind the last event of each map that is there."""
        ...

    def due(self, now_ns: int) -> list[WebhookRecord]:
        """Enabled ones of all tenants, with news and none later than `now_ns` to be tried: the longest due first."""
        ...

    def news(self, webhook: WebhookRecord) -> dict[str, News]:
        """The maps with events behind its position, by their ids."""
        ...

    def tell(self, webhook: WebhookRecord, told: Mapping[str, int]) -> None:
        """Its position in these maps is another now."""
        ...
