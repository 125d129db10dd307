"""A dry run: what a policy would remove of a map now, rule by rule, in reads only."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import MapRecord, ScanRecord, SessionRecord, SubmapRecord
from revisit.service.domain.retention import KeptScans, RetentionPolicy, RetentionRule
from revisit.service.features.deletion.blob_references import blobs_of_scans, blobs_of_submap, filed_maps, naming
from revisit.service.features.ingest.rows import described_scans
from revisit.service.features.retention import due
from revisit.service.features.retention.removal import portions
from revisit.service.features.retention.reports import (
    PAIR_ROW_BYTES,
    SCAN_ROW_BYTES,
    SUBMAP_ROW_BYTES,
    RetentionReport,
    RuleOutcome,
    Tally,
)
from revisit.service.features.retention.rules import HeldScans, due_for_release
from revisit.service.ports.blobs import CLOUD_BLOB, NEURAL_MAP_BLOB, Blob, BlobStore
from revisit.service.ports.repositories import SubmapStanding
from revisit.service.ports.transactions import Transactions, UnitOfWork

WEIGHED = 20_000
"""Blobs that are weighed one by one; the weight of more is that of these, in proportion."""

AT_ONCE = 500

T = TypeVar("T")


@dataclass
class _Going:
    """What would go: rows that name each blob, by the rule that removes the last of them.

    `touched`: sessions with submaps that would be retired, by the rule that is told of their scans.
    """

    named: dict[RetentionRule, Counter[Blob]] = field(default_factory=dict)
    retiring: set[int] = field(default_factory=set)
    sessions: set[str] = field(default_factory=set)
    touched: dict[str, RetentionRule] = field(default_factory=dict)

    def blob(self, rule: RetentionRule, blob: Blob) -> None:
        self.named.setdefault(rule, Counter())[blob] += 1


class Preview:
    """One dry run; all of it blocks. Each session is read in a transaction of its own."""

    def __init__(
        self, transactions: Transactions, blobs: BlobStore, rules: Policy, record: MapRecord, policy: RetentionPolicy
    ) -> None:
        """As `Retention.of_map` would go about it."""
        self._transactions = transactions
        self._blobs = blobs
        self._rules = rules
        self._map = record
        self._policy = policy
        self._tally = Tally()
        self._going = _Going()
        self._held_back = set[int]()

    def report(self, now_ns: int) -> RetentionReport:
        """What would be removed at this time."""
        record, policy = self._map, self._policy
        held = self._read(partial(due.under_review, record=record))
        sessions = self._read(partial(due.due_sessions, record=record, policy=policy, now_ns=now_ns))
        for one in sessions:
            self._session(one, held.retired)
        stride_m = self._rules.for_map(self._map).submap.stride
        best = self._read(partial(due.due_retirements, record=record, policy=policy, within_m=stride_m))
        self._retire(RetentionRule.BEST_SUBMAPS, set(best) - self._going.retiring, held.retired)
        self._retired_maps(now_ns, stride_m, held.retired)
        for session in self._read(lambda uow: uow.sessions.find(record.tenant, map_id=record.map_id)):
            if session.session_id not in self._going.sessions:
                self._read(partial(self._scans, session=session, now_ns=now_ns, held=held.released))
        loops = self._read(lambda uow: len([None for _ in due.due_loops(uow, record, policy, now_ns)]))
        self._tally.add(RetentionRule.REJECTED_LOOPS, loop_closures=loops, bytes=loops * PAIR_ROW_BYTES)
        estimated = self._weigh()
        rests = sum(one.rests for one in sessions)
        return RetentionReport(now_ns, self._tally.outcomes(), len(self._held_back), rests, estimated)

    def of_session(self, session: SessionRecord) -> RuleOutcome:
        """What goes with a session that is deleted."""
        self._session(due.DueSession(session, rests=False), frozenset())
        self._weigh()
        return self._tally.rules[RetentionRule.SESSIONS]

    def _read(self, work: Callable[[UnitOfWork], T]) -> T:
        return self._transactions.read_here(work)

    def _session(self, one: due.DueSession, held: frozenset[int]) -> None:
        rule, session = RetentionRule.SESSIONS, one.session
        if one.rests:
            numbers = self._read(partial(due.described_in, session=session))
            self._retire(rule, set(numbers), held)
            return
        self._going.sessions.add(session.session_id)
        submaps, scans = self._read(partial(self._whole_session, session=session))
        rows = scans * SCAN_ROW_BYTES + submaps * SUBMAP_ROW_BYTES
        self._tally.add(rule, sessions=1, submaps=submaps, scans=scans, bytes=rows)

    def _whole_session(self, uow: UnitOfWork, session: SessionRecord) -> tuple[int, int]:
        """Count submaps and scans of a session that goes, and note their blobs."""
        scans = 0
        for page in due.scan_pages(uow, session):
            scans += len(page)
            for scan in page:
                self._scan(RetentionRule.SESSIONS, scan)
        submaps = uow.submaps.find(session.tenant, map_id=session.map_id, session_id=session.session_id)
        for blob in (blob for submap in submaps for blob in blobs_of_submap(submap)):
            self._going.blob(RetentionRule.SESSIONS, blob)
        return len(submaps), scans

    def _retire(self, rule: RetentionRule, numbers: set[int], held: frozenset[int]) -> None:
        self._held_back |= held & numbers
        gone = sorted(numbers - held)
        self._going.retiring |= set(gone)
        for some in portions(gone, AT_ONCE):
            found = self._read(partial(_numbered, tenant=self._map.tenant, numbers=some))
            self._going.touched |= dict.fromkeys(
                {submap.session_id for submap in found.values()} - self._going.touched.keys(), rule
            )
            for kind, sha256 in (blob for submap in found.values() for blob in blobs_of_submap(submap)):
                if kind != NEURAL_MAP_BLOB:
                    self._going.blob(rule, (kind, sha256))
        self._tally.add(rule, submaps=len(gone), bytes=len(gone) * SUBMAP_ROW_BYTES)

    def _retired_maps(self, now_ns: int, edge_m: float, held: frozenset[int]) -> None:
        """Count neural maps of retired submaps that would go, also of such that would be retired now."""
        read = partial(due.due_maps, record=self._map, policy=self._policy, edge_m=edge_m, now_ns=now_ns)
        numbers = set(self._read(partial(read, retiring=self._going.retiring, leaving=self._going.sessions)))
        self._held_back |= held & numbers
        files = self._read(partial(due.files, record=self._map)) if numbers else []
        filed = filed_maps(files, self._blobs.get)
        count = 0
        for some in portions(sorted(numbers - held), AT_ONCE):
            for submap in self._read(partial(_numbered, tenant=self._map.tenant, numbers=some)).values():
                if submap.neural_map_sha256 is not None and submap.neural_map_sha256 not in filed:
                    self._going.blob(RetentionRule.RETIRED_MAPS, (NEURAL_MAP_BLOB, submap.neural_map_sha256))
                    count += 1
        self._tally.add(RetentionRule.RETIRED_MAPS, submaps=count)

    def _scans(self, uow: UnitOfWork, session: SessionRecord, now_ns: int, held: frozenset[int]) -> None:
        """Count the scans of a session that would go, with the retired submaps, and with those that are due."""
        standings = uow.submaps.standings(session.tenant, session.map_id, session.session_id)
        retiring = {one.number for one in standings if one.number in self._going.retiring}
        numbers = set(due_for_release(standings, self._policy, now_ns, retiring))
        self._held_back |= held & numbers
        released = numbers - held
        if not retiring and not released:
            return
        chosen = self._chosen(uow, session, [one for one in standings if one.number in released])
        left = HeldScans.of(session, standings, retiring | released)
        rule = self._going.touched.get(session.session_id, RetentionRule.SCANS)
        for page in due.scan_pages(uow, session):
            for scan in page:
                if left.frees_cloud(scan) and scan.number not in chosen:
                    self._count(rule, scan)
        self._posted(uow, session, released)
        self._tally.add(RetentionRule.SCANS, submaps=len(released))

    def _chosen(self, uow: UnitOfWork, session: SessionRecord, released: list[SubmapStanding]) -> set[int]:
        """The numbers of scans that would stay of submaps that keep those of their description."""
        if self._policy.keep_scans is not KeptScans.DESCRIBED:
            return set()
        config, numbers = self._rules.for_map(self._map).submap, [one.number for one in released]
        parts = (uow.submaps.numbered(session.tenant, some).values() for some in portions(numbers, AT_ONCE))
        submaps = (submap for part in parts for submap in part)
        return {scan.number for submap in submaps for scan in described_scans(uow, submap, config)}

    def _posted(self, uow: UnitOfWork, session: SessionRecord, released: set[int]) -> None:
        for some in portions(sorted(released), AT_ONCE):
            for submap in uow.submaps.numbered(session.tenant, some).values():
                if submap.cloud_sha256 is not None:
                    self._going.blob(RetentionRule.SCANS, (CLOUD_BLOB, submap.cloud_sha256))

    def _count(self, rule: RetentionRule, scan: ScanRecord) -> None:
        self._tally.add(rule, scans=1, bytes=SCAN_ROW_BYTES)
        self._scan(rule, scan)

    def _scan(self, rule: RetentionRule, scan: ScanRecord) -> None:
        for blob in blobs_of_scans([scan]):
            self._going.blob(rule, blob)

    def _weigh(self) -> bool:
        """Add the bytes of blobs that no row would name any more; whether some were estimated."""
        gone, estimated = Counter[Blob](), False
        for rule, named in self._going.named.items():
            gone += named
            weighed = list(named)[:WEIGHED]
            bytes_ = sum(self._freed(some, gone) for some in portions(weighed, AT_ONCE))
            estimated |= len(weighed) < len(named)
            self._tally.add(rule, bytes=bytes_ * len(named) // max(len(weighed), 1))
        return estimated

    def _freed(self, blobs: tuple[Blob, ...], gone: Counter[Blob]) -> int:
        """Bytes of those of these blobs that as many rows name as would go."""
        counts = self._read(partial(_naming, tenant=self._map.tenant, blobs=blobs))
        freed = (blob for blob in blobs if counts[blob] <= gone[blob])
        return sum(self._blobs.disk_bytes(self._map.tenant, *blob) for blob in freed)


def _numbered(uow: UnitOfWork, tenant: TenantId, numbers: tuple[int, ...]) -> dict[int, SubmapRecord]:
    return uow.submaps.numbered(tenant, numbers)


def _naming(uow: UnitOfWork, tenant: TenantId, blobs: tuple[Blob, ...]) -> dict[Blob, int]:
    """How many rows name each of these blobs."""
    return {blob: naming(uow, tenant, blob) for blob in blobs}
