"""Repositories in memory over the rows of one transaction."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Generic, TypeVar, cast

from revisit.service.domain.errors import AlreadyExists, NotFound
from revisit.service.domain.events import ChangeOf, EventRecord
from revisit.service.domain.identity import TenantId
from revisit.service.domain.processes import LivingProcess, ProcessRole
from revisit.service.domain.records import (
    DeletionRecord,
    JobRecord,
    LoopRecord,
    MapRecord,
    PlanRecord,
    ScanRecord,
    SubmapRecord,
    TurnRecord,
    WorkerRecord,
)
from revisit.service.domain.states import EventKind, LoopState, OperationState, SubmapState
from revisit.service.domain.webhooks import News, WebhookRecord
from revisit.service.ports.clock import Clock
from revisit.service.ports.index import IndexChange
from revisit.service.ports.job_queue import Standing
from revisit.service.ports.processes import GONE_AFTER_MS
from revisit.service.ports.repositories import FoundSubmap, LoopEnds, PathPoint, PlacedSubmap, SubmapStanding, Waiting

R = TypeVar("R")

Scalar = str | int | None


@dataclass
class Rows:
    """The rows of one table by number, in the order of these, with the numbers of their keys where they have any; the
    last number given out, in all and by map.
    """

    by_number: dict[int, Any] = field(default_factory=dict)
    numbers: dict[Any, int] = field(default_factory=dict)
    last: int = 0
    last_of: dict[Any, int] = field(default_factory=dict)

    def copy(self) -> Rows:
        """An independent copy; records are immutable."""
        return Rows(dict(self.by_number), dict(self.numbers), self.last, dict(self.last_of))

    def fixed(self) -> Rows:
        """The same rows for those who only read."""
        return Rows(_fixed(self.by_number), _fixed(self.numbers), self.last, _fixed(self.last_of))

    def next_of(self, key: Any) -> int:
        """The next number within a map."""
        self.last_of[key] = self.last_of.get(key, 0) + 1
        return self.last_of[key]


def _fixed(rows: dict[Any, Any]) -> dict[Any, Any]:
    """A view that refuses changes."""
    return cast("dict[Any, Any]", MappingProxyType(rows))


class Doomed:
    """What is being deleted, for those who shall not see it."""

    def __init__(self, deletions: Rows) -> None:
        """`deletions` are the rows of `DeletionRecord`."""
        self._deletions = deletions

    def hides(self, row: Any) -> bool:
        """Whether the map of a row, or a session that it names, is being deleted."""
        deletions: Collection[DeletionRecord] = self._deletions.by_number.values()
        if not deletions:
            return False
        named = {"", *(getattr(row, field, "") for field in SESSION_FIELDS)}
        return any(
            (one.tenant, one.map_id) == (row.tenant, row.map_id) and one.session_id in named for one in deletions
        )


SESSION_FIELDS = ("session_id", "query_session_id", "match_session_id")
"""The fields of records that name sessions with which a row goes."""


class MemoryRepository(Generic[R]):
    """`Repository` over `Rows`."""

    def __init__(
        self, rows: Rows, key: tuple[str, ...], on_change: ChangeOf[R] | None = None, doomed: Doomed | None = None
    ) -> None:
        """`key` names the fields that, with the tenant, identify a record; `on_change` hears each add and replace.

        Rows that `doomed` hides are not seen.
        """
        self._rows = rows
        self._doomed = doomed
        self._on_change = on_change
        self._key_of = attrgetter("tenant", *key)

    def add(self, record: R) -> R:
        """See `Repository`."""
        if self._key_of(record) in self._rows.numbers:
            raise AlreadyExists
        self._rows.last += 1
        added: R = dataclasses.replace(record, number=self._rows.last)  # type: ignore[type-var]  # R is a record
        self._rows.by_number[self._rows.last] = added
        self._rows.numbers[self._key_of(added)] = self._rows.last
        if self._on_change is not None:
            self._on_change(None, added)
        return added

    def add_all(self, records: Sequence[R]) -> None:
        """See `Repository`."""
        for record in records:
            self.add(record)

    def get(self, tenant: TenantId, *key: str | int, hold: bool = False) -> R | None:
        """See `Repository`."""
        number = self._rows.numbers.get((tenant, *key))
        row = None if number is None else self._rows.by_number[number]
        return row if row is not None and self._is_seen(row) else None

    def find(self, tenant: TenantId, *, after: int = 0, limit: int | None = None, **equals: Scalar) -> list[R]:
        """See `Repository`."""
        return [row for row in self._matching(tenant, equals) if row.number > after][:limit]

    def numbered(self, tenant: TenantId, numbers: Sequence[int], *, hold: bool = False) -> dict[int, R]:
        """See `Repository`."""
        rows = (self._rows.by_number.get(number) for number in sorted(set(numbers)))
        return {row.number: row for row in rows if row is not None and row.tenant == tenant and self._is_seen(row)}

    def distinct(self, tenant: TenantId, field: str, **equals: Scalar) -> set[Any]:
        """See `Repository`."""
        return {getattr(row, field) for row in self._matching(tenant, equals)} - {None}

    def count(self, tenant: TenantId, **equals: Scalar) -> int:
        """See `Repository`."""
        return len(self._matching(tenant, equals))

    def damaged(self, tenant: TenantId, **equals: Scalar) -> list[int]:
        """See `Repository`."""
        return []

    def count_of_all_tenants(self, **equals: Scalar) -> int:
        """See `Repository`."""
        return sum(self._is_seen(row) for row in _equal(self._rows.by_number.values(), equals))

    def of_all_tenants(self, *, after: int = 0, limit: int | None = None) -> list[R]:
        """See `Repository`."""
        rows = (row for number, row in self._rows.by_number.items() if number > after)
        return [row for row in rows if self._is_seen(row)][:limit]

    def replace(self, record: R) -> None:
        """See `Repository`."""
        number = record.number  # type: ignore[attr-defined]  # R is a record
        if number not in self._rows.by_number:
            raise NotFound
        before = self._rows.by_number[number]
        self._rows.by_number[number] = record
        if self._on_change is not None:
            self._on_change(before, record)

    def replace_all(self, records: Sequence[R]) -> None:
        """See `Repository`."""
        for record in records:
            self.replace(record)

    def revise(self, records: Sequence[R], **fields: Scalar) -> None:
        """See `Repository`."""
        for record in records:
            told: Any = record
            stored = self._rows.by_number.get(told.number)
            if stored is None or stored.tenant != told.tenant:
                raise NotFound
            self.replace(dataclasses.replace(stored, **fields))

    def delete(self, tenant: TenantId, **equals: Scalar) -> int:
        """See `Repository`."""
        return self._deleted([row.number for row in self._having(tenant, equals)])

    def some(self, tenant: TenantId, limit: int, **equals: Scalar) -> list[R]:
        """See `Repository`."""
        return self._matching(tenant, equals)[:limit]

    def delete_some(self, tenant: TenantId, limit: int, field: str, values: Sequence[str | int]) -> int:
        """See `Repository`."""
        some = [row.number for row in self._having(tenant, {}) if getattr(row, field) in values]
        return self._deleted(some[:limit])

    def _deleted(self, numbers: Sequence[int]) -> int:
        for number in numbers:
            del self._rows.numbers[self._key_of(self._rows.by_number.pop(number))]
        return len(numbers)

    def _matching(self, tenant: TenantId, equals: dict[str, Scalar]) -> list[Any]:
        return [row for row in self._having(tenant, equals) if self._is_seen(row)]

    def _having(self, tenant: TenantId, equals: dict[str, Scalar]) -> list[Any]:
        """Rows that have what is asked, seen or not."""
        return _equal(self._rows.by_number.values(), {"tenant": tenant, **equals})

    def _is_seen(self, row: Any) -> bool:
        return self._doomed is None or not self._doomed.hides(row)


def _equal(rows: Collection[Any], equals: dict[str, Scalar]) -> list[Any]:
    """Rows whose fields have these values."""
    if not equals:
        return list(rows)
    fields_of, values = attrgetter(*equals), tuple(equals.values())
    wanted = values if len(values) > 1 else values[0]
    return [row for row in rows if fields_of(row) == wanted]


class MemoryScans(MemoryRepository[ScanRecord]):
    """`ScanRepository`."""

    def first_seq_from(self, tenant: TenantId, map_id: str, session_id: str, travelled_m: float) -> int | None:
        """See `ScanRepository`."""
        scans = self.find(tenant, map_id=map_id, session_id=session_id)
        return min((scan.seq for scan in scans if scan.travelled_m >= travelled_m), default=None)

    def chosen_between(
        self, tenant: TenantId, map_id: str, session_id: str, first: int, last: int, newest: int | None = None
    ) -> list[ScanRecord]:
        """See `ScanRepository`."""
        scans = self.find(tenant, map_id=map_id, session_id=session_id, chosen=True)
        found = sorted((scan for scan in scans if first <= scan.seq <= last), key=lambda scan: scan.seq)
        return found if newest is None else found[-newest:]

    def around(self, tenant: TenantId, map_id: str, session_id: str, stamp_ns: int, limit: int) -> list[ScanRecord]:
        """See `ScanRepository`."""
        scans = sorted(self.find(tenant, map_id=map_id, session_id=session_id), key=lambda scan: scan.seq)
        before = sum(scan.stamp_ns <= stamp_ns for scan in scans)
        return scans[max(0, before - 1) :][:limit]

    def points_of(self, tenant: TenantId) -> int:
        """See `ScanRepository`."""
        return sum(scan.point_count for scan in self.find(tenant))

    def with_seqs(self, tenant: TenantId, map_id: str, session_id: str, seqs: Sequence[int]) -> list[ScanRecord]:
        """See `ScanRepository`."""
        scans = self.find(tenant, map_id=map_id, session_id=session_id)
        return sorted((scan for scan in scans if scan.seq in set(seqs)), key=lambda scan: scan.seq)


class MemoryPlans(MemoryRepository[PlanRecord]):
    """`PlanRepository`."""

    def bytes_of(self, tenant: TenantId) -> int:
        """See `PlanRepository`."""
        return sum(plan.size_bytes for plan in self.find(tenant))


class MemorySubmaps(MemoryRepository[SubmapRecord]):
    """`SubmapRepository`."""

    def add(self, record: SubmapRecord) -> SubmapRecord:
        """See `Repository`; the `seq` is given at once."""
        return super().add(dataclasses.replace(record, seq=self._rows.next_of((record.tenant, record.map_id))))

    def last_seq(self, tenant: TenantId, map_id: str) -> int:
        """See `SubmapRepository`."""
        return self._rows.last_of.get((tenant, map_id), 0)

    def points_of(self, tenant: TenantId) -> int:
        """See `SubmapRepository`."""
        return sum(row.point_count for row in self.find(tenant) if row.cloud_sha256 is not None)

    def placed(self, tenant: TenantId, map_id: str, after: int = 0) -> list[PlacedSubmap]:
        """See `SubmapRepository`."""
        later = [one for one in self.find(tenant, map_id=map_id) if one.seq > after]
        of_map = sorted(later, key=lambda one: (one.session_number, one.ordinal))
        return [
            PlacedSubmap(one.number, one.session_number, one.ordinal, one.T_odom_submap, one.stamp_ns) for one in of_map
        ]

    def found(self, tenant: TenantId, numbers: Sequence[int]) -> dict[int, FoundSubmap]:
        """See `SubmapRepository`."""
        fields = [field.name for field in dataclasses.fields(FoundSubmap)]
        found = self.numbered(tenant, numbers)
        return {number: FoundSubmap(*(getattr(row, name) for name in fields)) for number, row in found.items()}

    def path(
        self, tenant: TenantId, map_id: str, session_id: str, ordinal: int, limit: int, *, back: bool = False
    ) -> list[PathPoint]:
        """See `SubmapRepository`."""
        drive = self.find(tenant, map_id=map_id, session_id=session_id)
        ahead = [one for one in drive if (one.ordinal < ordinal if back else one.ordinal > ordinal)]
        ahead.sort(key=lambda one: one.ordinal, reverse=back)
        return [PathPoint(one.number, one.ordinal, one.position_m) for one in ahead[:limit]]

    def standings(self, tenant: TenantId, map_id: str, session_id: str | None = None) -> list[SubmapStanding]:
        """See `SubmapRepository`."""
        rows = self.find(tenant, map_id=map_id, **({} if session_id is None else {"session_id": session_id}))
        names = [one.name for one in dataclasses.fields(SubmapStanding)]
        return [SubmapStanding(*(getattr(row, name) for name in names)) for row in rows]

    def first_waiting(self, tenant: TenantId, map_id: str) -> int | None:
        """See `SubmapRepository`."""
        queued = self.find(tenant, map_id=map_id, state=SubmapState.QUEUED.value)
        return min((row.seq for row in queued), default=None)

    def first_unsearched(self, tenant: TenantId, map_id: str) -> int | None:
        """See `SubmapRepository`."""
        return min((row.seq for row in self.find(tenant, map_id=map_id) if not row.searched), default=None)

    def flag_counts(self, tenant: TenantId, map_id: str, session_id: str) -> dict[str, int]:
        """See `SubmapRepository`."""
        rows = self.find(tenant, map_id=map_id, session_id=session_id)
        failures = [row.failure_code for row in rows if row.failure_code is not None]
        return dict(Counter([flag for row in rows for flag in row.flags] + failures))


class MemoryLoops(MemoryRepository[LoopRecord]):
    """`LoopRepository`."""

    def accepted(
        self, tenant: TenantId, map_id: str, *, after: int = 0, limit: int | None = None, **equals: Scalar
    ) -> list[LoopRecord]:
        """See `LoopRepository`."""
        found = self.find(tenant, map_id=map_id, state=LoopState.ACCEPTED.value, **equals)
        return sorted((loop for loop in found if loop.seq > after), key=lambda loop: loop.seq)[:limit]

    def measured(self, tenant: TenantId, map_id: str, *, after: int, limit: int) -> list[LoopRecord]:
        """See `LoopRepository`."""
        rows = self.find(tenant, after=after, limit=limit, map_id=map_id, state=LoopState.ACCEPTED.value)
        measured = (row.evidence.get("measurement", {}).get("covariance", []) for row in rows)
        return [
            dataclasses.replace(row, evidence={"measurement": {"covariance": its}})
            for row, its in zip(rows, measured, strict=True)
        ]

    def telling(self, tenant: TenantId, query_numbers: Sequence[int], reasons: Sequence[str]) -> list[LoopRecord]:
        """See `LoopRepository`."""
        found = [loop for number in sorted(set(query_numbers)) for loop in self.find(tenant, query_number=number)]
        return [loop for loop in found if loop.state == LoopState.ACCEPTED or loop.reason in reasons]

    def rejected(
        self, tenant: TenantId, map_id: str, reasons: Sequence[str], *, after: int, limit: int
    ) -> list[LoopEnds]:
        """See `LoopRepository`."""
        rows = self.find(tenant, after=after, map_id=map_id, state=LoopState.REJECTED.value, manual=False)
        names = [field.name for field in dataclasses.fields(LoopEnds)]
        found = (LoopEnds(*(getattr(row, name) for name in names)) for row in rows if row.reason in reasons)
        return list(islice(found, limit))

    def reasons(self, tenant: TenantId, numbers: Sequence[int]) -> dict[str | None, int]:
        """See `LoopRepository`."""
        asked = set(numbers)
        found = (row for row in self.find(tenant) if asked & {row.query_number, row.match_number})
        return dict(Counter(row.reason for row in found))


class MemoryJobs(MemoryRepository[JobRecord]):
    """`JobRepository`."""

    def next_runnable(
        self, now_ms: int, tenant: TenantId, *, lost: bool = True, hold: bool = False
    ) -> JobRecord | None:
        """See `LeasableJobs`."""
        due = [job for job in self._all() if job.tenant == tenant and _due(job, now_ms)]
        due = [job for job in due if lost or job.state == OperationState.QUEUED]
        return min(due, key=lambda job: (job.priority, job.number), default=None)

    def unfinished(self, tenant: TenantId, operation_ids: Collection[str]) -> frozenset[str]:
        """See `JobRepository`."""
        going_on = (OperationState.QUEUED, OperationState.RUNNING)
        ids = {job.operation_id for job in self._all() if job.tenant == tenant and job.state in going_on}
        return frozenset(ids.intersection(operation_ids))

    def exchange(self, before: JobRecord, after: JobRecord) -> None:
        """See `LeasableJobs`."""
        self.replace(after)

    def exhausted(self, now_ms: int, *, hold: bool = False) -> list[JobRecord]:
        """See `LeasableJobs`."""
        return [job for job in self._all() if _lost(job, now_ms) and job.counted_attempts >= job.max_attempts]

    def leased_to(self, owner: str | None) -> list[JobRecord]:
        """See `LeasableJobs`."""
        running = (job for job in self._all() if job.state == OperationState.RUNNING)
        return [job for job in running if owner in (None, job.lease_owner)]

    def fail_damaged(self, code: str, message: str, finished_at_ns: int) -> list[JobRecord]:
        """See `LeasableJobs`."""
        return []

    def forget_answers(self, before_ns: int, limit: int) -> int:
        """See `JobRepository`."""
        ended = [(job.finished_at_ns, job.number) for job in self._all() if job.priority == 0 and job.finished_at_ns]
        old = [number for finished_at_ns, number in sorted(ended) if finished_at_ns < before_ns][:limit]
        return self._deleted(old)

    def waiting(self) -> Waiting:
        """See `JobRepository`."""
        first = {OperationState.QUEUED: 0, OperationState.RUNNING: 1}
        queued_ns = (job.created_at_ns for job in self._all() if job.state == OperationState.QUEUED)
        begun_again = sum(job.attempts > first[job.state] for job in self._all() if job.state in first)
        return Waiting(min(queued_ns, default=None), begun_again)

    def _all(self) -> list[JobRecord]:
        return list(self._rows.by_number.values())


def _lost(job: JobRecord, now_ms: int) -> bool:
    return job.state == OperationState.RUNNING and job.lease_expires_ms <= now_ms


def _due(job: JobRecord, now_ms: int) -> bool:
    if job.state == OperationState.QUEUED:
        return job.not_before_ms <= now_ms
    return _lost(job, now_ms) and job.counted_attempts < job.max_attempts


@dataclass(frozen=True)
class _Change:
    """`submap_number` is that of a session where `whole_session`."""

    tenant: str
    map_number: int
    submap_number: int
    number: int
    described: bool = False
    whole_session: bool = False


class MemoryChangeLog:
    """`ChangeLog`."""

    def __init__(self, changes: Rows, submaps: Rows) -> None:
        """`submaps` tells whether a described submap is still there."""
        self._changes = changes
        self._submaps = submaps

    def record_described(self, record: MapRecord, submap_number: int) -> None:
        """See `ChangeLog`."""
        seq = self._append(record, submap_number, described=True)
        if (submap := self._submaps.by_number.get(submap_number)) is not None:
            self._submaps.by_number[submap_number] = dataclasses.replace(submap, entered=seq)

    def record_removed(self, record: MapRecord, submap_numbers: Collection[int]) -> None:
        """See `ChangeLog`."""
        for number in sorted(submap_numbers):
            self._append(record, number)

    def record_session_removed(self, record: MapRecord, session_number: int) -> None:
        """See `ChangeLog`."""
        self._append(record, session_number, whole_session=True)

    def since(self, tenant: TenantId, map_number: int, seq: int, limit: int | None = None) -> list[IndexChange]:
        """See `ChangeLog`."""
        return [
            self._seen(change)
            for change in self._changes.by_number.values()
            if (change.tenant, change.map_number) == (tenant, map_number) and change.number > seq
        ][:limit]

    def _append(self, record: MapRecord, number: int, **fields: bool) -> int:
        seq = self._changes.next_of(record.number)
        self._changes.last += 1
        self._changes.by_number[self._changes.last] = _Change(record.tenant, record.number, number, seq, **fields)
        return seq

    def _seen(self, change: _Change) -> IndexChange:
        if change.whole_session:
            return IndexChange.session_removed(change.number, change.submap_number)
        submap: SubmapRecord | None = self._submaps.by_number.get(change.submap_number)
        if submap is None:
            return IndexChange(change.number, change.submap_number, 0, 0, (0.0, 0.0, 0.0), None)
        vector = submap.descriptor if change.described else None
        place = (submap.session_number, submap.ordinal, submap.position_m)
        return IndexChange(change.number, change.submap_number, *place, vector)


class MemoryEventLog:
    """`EventLog`."""

    def __init__(self, rows: Rows, maps: MemoryMaps, loops: Rows) -> None:
        """`rows` in the order in which they came; what is no event any more has the kind FORGOTTEN."""
        self._rows, self._maps, self._loops = rows, maps, loops

    def record(self, event: EventRecord, *, accepts: bool = False) -> None:
        """See `EventLog`."""
        if self._maps.everything_has(event.tenant, event.map_id):
            self._rows.last += 1
            number = self._rows.next_of((event.tenant, event.map_id))
            self._rows.by_number[self._rows.last] = dataclasses.replace(event, number=number)
            if accepts:
                self._accept(event, number)

    def _accept(self, event: EventRecord, number: int) -> None:
        its = (event.tenant, event.map_id, event.subject)
        for at, loop in self._loops.by_number.items():
            if (loop.tenant, loop.map_id, loop.loop_id) == its:
                self._loops.by_number[at] = dataclasses.replace(loop, seq=number)

    def following(self, tenant: TenantId, map_id: str, number: int, limit: int) -> list[EventRecord]:
        """See `EventLog`."""
        own = _equal(self._rows.by_number.values(), {"tenant": tenant, "map_id": map_id})
        gone = [row for row in own if row.kind == EventKind.FORGOTTEN and row.number > number][-1:]
        return (gone + [row for row in own if row.kind != EventKind.FORGOTTEN and row.number > number])[:limit]

    def last_numbers(self, maps: Collection[tuple[TenantId, str]]) -> dict[tuple[TenantId, str], int]:
        """See `EventLog`."""
        return {key: self._rows.last_of.get(key, 0) for key in maps if self._maps.get(*key) is not None}

    def forget(self, kept: int) -> int:
        """See `EventLog`."""
        tenants = {row.tenant for row in self._rows.by_number.values()}
        return sum(self._forget_of(tenant, kept) for tenant in tenants)

    def _forget_of(self, tenant: TenantId, kept: int) -> int:
        rows = self._rows.by_number
        own = [at for at, row in sorted(rows.items()) if row.tenant == tenant and row.kind != EventKind.FORGOTTEN]
        old = own[: max(0, len(own) - kept)]
        for at in old:
            rows[at] = dataclasses.replace(rows[at], kind=EventKind.FORGOTTEN.value, subject="")
        return len(old)


class MemoryMaps(MemoryRepository[MapRecord]):
    """`Repository` of maps."""

    def everything_has(self, tenant: TenantId, map_id: str) -> bool:
        """Whether the map is there, be it that it is being deleted."""
        return any((row.tenant, row.map_id) == (tenant, map_id) for row in self._rows.by_number.values())


class MemoryWebhooks(MemoryRepository[WebhookRecord]):
    """`WebhookRepository`."""

    def __init__(self, rows: Rows, maps: MemoryMaps, events: MemoryEventLog) -> None:
        """Positions are kept beside `rows`."""
        super().__init__(rows, ("webhook_id",))
        self._maps, self._events = maps, events

    def add(self, record: WebhookRecord) -> WebhookRecord:
        """See `WebhookRepository`."""
        added = super().add(record)
        self.tell(added, self._last(added))
        return added

    def due(self, now_ns: int) -> list[WebhookRecord]:
        """See `WebhookRepository`."""
        rows = [row for row in self.of_all_tenants() if row.state == "ENABLED" and row.due_at_ns <= now_ns]
        return sorted((row for row in rows if self.news(row)), key=lambda row: row.due_at_ns)

    def news(self, webhook: WebhookRecord) -> dict[str, News]:
        """See `WebhookRepository`."""
        told = {map_id: self._rows.last_of.get((webhook.number, map_id), 0) for map_id in self._last(webhook)}
        news = {map_id: News(told[map_id], last) for map_id, last in self._last(webhook).items()}
        return {map_id: one for map_id, one in news.items() if one.last > one.told}

    def tell(self, webhook: WebhookRecord, told: Mapping[str, int]) -> None:
        """See `WebhookRepository`."""
        self._rows.last_of.update({(webhook.number, map_id): number for map_id, number in told.items()})

    def _last(self, webhook: WebhookRecord) -> dict[str, int]:
        maps = [one.map_id for one in self._maps.find(webhook.tenant) if webhook.map_id in (None, one.map_id)]
        return {
            key[1]: last for key, last in self._events.last_numbers([(webhook.tenant, one) for one in maps]).items()
        }


class MemoryWorkerLog:
    """`WorkerLog`."""

    def __init__(self, rows: Rows, clock: Clock) -> None:
        """Workers by their place in `rows`."""
        self._rows = rows
        self._clock = clock

    def beat(self, worker_id: str, model_version: str) -> None:
        """See `WorkerLog`."""
        worker = WorkerRecord(worker_id, model_version, self._clock.monotonic_ms())
        self.forget(worker_id)
        self._rows.last += 1
        self._rows.by_number[self._rows.last] = worker

    def alive(self, within_ms: int) -> list[WorkerRecord]:
        """See `WorkerLog`."""
        now_ms = self._clock.monotonic_ms()
        alive = [one for one in self._rows.by_number.values() if one.seen_ms >= now_ms - within_ms]
        return sorted(alive, key=lambda worker: (-worker.seen_ms, worker.worker_id))

    def silent(self, since_ms: int) -> list[str]:
        """See `WorkerLog`."""
        now_ms = self._clock.monotonic_ms()
        return [one.worker_id for one in self._rows.by_number.values() if one.seen_ms < now_ms - since_ms]

    def forget(self, worker_id: str) -> None:
        """See `WorkerLog`."""
        kept = {number: row for number, row in self._rows.by_number.items() if row.worker_id != worker_id}
        self._rows.by_number.clear()
        self._rows.by_number.update(kept)


class MemoryProcessLog:
    """`ProcessLog`."""

    def __init__(self, rows: Rows, clock: Clock) -> None:
        """Processes with the moment at which they were seen, by their place in `rows`."""
        self._rows = rows
        self._clock = clock

    def announce(self, process: LivingProcess) -> None:
        """See `ProcessLog`."""
        now_ms = self._clock.monotonic_ms()
        known = [row for row in self._rows.by_number.values() if row[0].process_id == process.process_id]
        came_ms = known[0][1] if known and known[0][2] >= now_ms - GONE_AFTER_MS else now_ms
        self.forget(process.process_id)
        self._rows.last += 1
        self._rows.by_number[self._rows.last] = (process, came_ms, now_ms)

    def alive(self, role: ProcessRole, within_ms: int) -> list[LivingProcess]:
        """See `ProcessLog`."""
        since_ms = self._clock.monotonic_ms() - within_ms
        seen = [row for row in self._rows.by_number.values() if row[2] >= since_ms and row[0].role is role]
        return [process for process, *_ in sorted(seen, key=lambda row: (row[1], row[0].process_id))]

    def forget(self, process_id: str) -> None:
        """See `ProcessLog`."""
        kept = {number: row for number, row in self._rows.by_number.items() if row[0].process_id != process_id}
        self._rows.by_number.clear()
        self._rows.by_number.update(kept)


class MemoryTenantTurns:
    """`TenantTurns`."""

    def __init__(self, turns: Rows, jobs: MemoryJobs) -> None:
        """Pairs of a worker and a turn in `turns`; `jobs` tells who waits."""
        self._turns = turns
        self._jobs = jobs

    def standing(self) -> Standing:
        """See `TenantTurns`."""
        unfinished = (OperationState.QUEUED, OperationState.RUNNING)
        jobs = [job for job in self._jobs.of_all_tenants() if job.state in unfinished]
        turns = [
            _sum(tenant, [turn for _, turn in self._rows() if turn.tenant == tenant])
            for tenant in sorted({job.tenant for job in jobs})
        ]
        latest_ms = max((turn.started_ms for _, turn in self._rows()), default=0)
        running = (job.lease_expires_ms for job in jobs if job.state == OperationState.RUNNING)
        return Standing(turns, latest_ms, min(running, default=None))

    def of_worker(self, worker_id: str) -> list[TurnRecord]:
        """See `TenantTurns`."""
        return [turn for worker, turn in self._rows() if worker == worker_id]

    def add(self, turn: TurnRecord, worker_id: str) -> None:
        """See `TenantTurns`."""
        of_it = [one for one in self.of_worker(worker_id) if one.tenant == turn.tenant]
        others = [row for row in self._rows() if row[0] != worker_id or row[1].tenant != turn.tenant]
        self._keep([*others, (worker_id, _sum(turn.tenant, [*of_it, turn]))])

    def forget(self, worker_id: str) -> None:
        """See `TenantTurns`."""
        self._keep([row for row in self._rows() if row[0] != worker_id])

    def mend(self) -> None:
        """See `TenantTurns`: nothing is damaged here."""

    def _rows(self) -> list[tuple[str, TurnRecord]]:
        return list(self._turns.by_number.values())

    def _keep(self, rows: list[tuple[str, TurnRecord]]) -> None:
        self._turns.by_number.clear()
        self._turns.by_number.update(enumerate(rows))


def _sum(tenant: TenantId, turns: Sequence[TurnRecord]) -> TurnRecord:
    started_ms = max((turn.started_ms for turn in turns), default=0)
    lifted_ms = max((turn.lifted_ms for turn in turns), default=0)
    return TurnRecord(tenant, started_ms, sum(turn.ran_ms for turn in turns), lifted_ms)
