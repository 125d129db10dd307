"""Retention at work: every map is brought to its policy, or asked what that would take."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice

import structlog

from revisit.core.errors import DataLoss
from revisit.service.domain.events import EventRecord
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import LoopRecord, MapRecord, ScanRecord, SessionRecord
from revisit.service.domain.retention import KEEPS_ALL, KeptScans, RetentionPolicy, RetentionRule
from revisit.service.domain.states import EventKind, SessionState
from revisit.service.failpoints import failpoint
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.features.deletion.blob_references import filed_maps, naming
from revisit.service.features.retention import due, removal
from revisit.service.features.retention.preview import Preview
from revisit.service.features.retention.removal import Removed, portions
from revisit.service.features.retention.reports import (
    PAIR_ROW_BYTES,
    SCAN_ROW_BYTES,
    SUBMAP_ROW_BYTES,
    RetentionReport,
    Tally,
)
from revisit.service.features.retention.rules import HeldScans, due_for_release
from revisit.service.ports.blobs import Blob
from revisit.service.ports.clock import Clock
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork

MAPS_A_PAGE = 100

AT_A_TIME = 4_000
"""Scans or loops of which one read tells."""

log = structlog.get_logger(__name__)


class Retention:
    """Brings maps to their policies; what is left of an earlier process is found in the first run."""

    def __init__(self, storage: Storage, clock: Clock, rules: Policy) -> None:
        """`rules` has the policy of maps without one of their own."""
        self._storage = storage
        self._clock = clock
        self._rules = rules
        self._known = set[int]()
        self._ranked = dict[int, tuple[int, int | None, int]]()

    async def all(self, now_ns: int | None = None) -> None:
        """One run over every map of every tenant, as of `now_ns`; the wall clock's time by default.

        A map with damaged rows is passed over: another policy would remove what its owner keeps.
        """
        async for record in self._maps():
            try:
                policy = self._rules.kept_of(record)
                if policy != KEEPS_ALL:
                    await self._storage.read(partial(_require_whole, record=record))
                    await self.of_map(record, policy, now_ns)
            except DataLoss as error:
                log.error("retention_stopped", tenant=record.tenant, map=record.map_id, reason=error.reason)

    async def _maps(self) -> AsyncIterator[MapRecord]:
        after: int | None = 0
        while after is not None:
            page = await self._storage.read(partial(_map_page, after=after))
            for record in page:
                yield record
            after = page[-1].number if page else None  # damaged rows are in no page

    async def of_map(self, record: MapRecord, policy: RetentionPolicy, now_ns: int | None = None) -> RetentionReport:
        """Remove what the policy of a map does not keep, and note what was removed."""
        as_of_ns = self._clock.wall_ns() if now_ns is None else now_ns
        run = _Run(self._storage, self._rules, record, policy, as_of_ns)
        await run.sessions()
        active = await self._storage.read(partial(_active_sessions, record=record))
        ranked = (record.map_version, policy.best_submaps, active)
        if self._ranked.get(record.number) != ranked:
            await run.best_submaps()
        if not run.held_back:
            self._ranked[record.number] = ranked
        await run.retired_maps()
        await run.scans(leftovers=record.number not in self._known)
        await run.rejected_loops()
        self._known.add(record.number)
        return await run.noted()


class _Run:
    """One run over one map."""

    def __init__(
        self,
        storage: Storage,
        rules: Policy,
        record: MapRecord,
        policy: RetentionPolicy,
        now_ns: int,
    ) -> None:
        self._storage = storage
        self._rules = rules
        self._map = record
        self._policy = policy
        self._now_ns = now_ns
        self._tally = Tally()
        self._held: due.UnderReview | None = None
        self.held_back = set[int]()
        self._sessions_held = 0
        self._touched = dict[str, RetentionRule]()

    async def _under_review(self) -> due.UnderReview:
        if self._held is None:
            self._held = await self._storage.read(partial(due.under_review, record=self._map))
        return self._held

    async def sessions(self) -> None:
        """Delete sessions whose time is over; of such that the map rests on, retire the submaps."""
        read = partial(due.due_sessions, record=self._map, policy=self._policy, now_ns=self._now_ns)
        for one in await self._storage.read(read):
            self._sessions_held += one.rests
            if one.rests:
                described = partial(due.described_in, session=one.session)
                await self._retire(RetentionRule.SESSIONS, await self._storage.read(described))
                continue
            await self._delete(one.session)

    async def _delete(self, session: SessionRecord) -> None:
        """Mark a session as deleted, whose rows and blobs the erasure removes."""
        asked = (self._storage.transactions, self._storage.blobs, self._rules, self._map, self._policy)
        going = await asyncio.to_thread(Preview(*asked).of_session, session)
        removed, _ = await self._removed(partial(removal.delete_session, session=session, at_ns=self._now_ns))
        if removed:
            self._tally.add(RetentionRule.SESSIONS, **going.counts())

    async def best_submaps(self) -> None:
        """Retire the submaps that are none of the best of their place."""
        within_m = self._rules.for_map(self._map).submap.stride
        if self._policy.best_submaps is not None:
            read = partial(due.due_retirements, record=self._map, policy=self._policy, within_m=within_m)
            await self._retire(RetentionRule.BEST_SUBMAPS, await self._storage.read(read))

    async def _retire(self, rule: RetentionRule, numbers: Sequence[int]) -> None:
        held = (await self._under_review()).retired if numbers else frozenset[int]()
        self.held_back |= held.intersection(numbers)
        for some in portions((one for one in numbers if one not in held), removal.SUBMAPS):
            removed, freed = await self._removed(partial(removal.retire, record=self._map, numbers=some))
            self._tally.add(rule, submaps=removed, bytes=freed + removed * SUBMAP_ROW_BYTES)
            sessions = await self._storage.read(partial(_sessions_of, tenant=self._map.tenant, numbers=some))
            self._touched |= dict.fromkeys(sessions - self._touched.keys(), rule)

    async def retired_maps(self) -> None:
        """Remove neural maps of retired submaps whose place a later drive shows."""
        if self._policy.retired_days is None:
            return
        edge_m = self._rules.for_map(self._map).submap.stride
        read = partial(due.due_maps, record=self._map, policy=self._policy, edge_m=edge_m, now_ns=self._now_ns)
        numbers = await self._storage.read(read)
        if not numbers:
            return
        held = (await self._under_review()).retired
        self.held_back |= held.intersection(numbers)
        files = await self._storage.read(partial(due.files, record=self._map))
        filed = await asyncio.to_thread(filed_maps, files, self._storage.blobs.get)
        release = partial(removal.release_maps, record=self._map, filed=filed)
        for some in portions((one for one in numbers if one not in held), removal.SUBMAPS):
            removed, freed = await self._removed(partial(release, numbers=some))
            self._tally.add(RetentionRule.RETIRED_MAPS, submaps=removed, bytes=freed)

    async def scans(self, *, leftovers: bool) -> None:
        """Remove scans; with `leftovers` also such as an earlier process has left behind."""
        ids = set(await self._storage.read(partial(due.sessions_with_scans, record=self._map, policy=self._policy)))
        if leftovers:
            ids |= await self._storage.read(partial(_session_ids, record=self._map))
        for session_id in sorted(ids | self._touched.keys()):
            await self._release(session_id, anyway=leftovers or session_id in self._touched)

    async def _release(self, session_id: str, *, anyway: bool) -> None:
        """Release the scans of a session's submaps that are due, and drop what nothing holds any more."""
        standings = await self._storage.read(
            lambda uow: uow.submaps.standings(self._map.tenant, self._map.map_id, session_id)
        )
        numbers = due_for_release(standings, self._policy, self._now_ns, ())
        if numbers:
            held = (await self._under_review()).released
            self.held_back |= held.intersection(numbers)
            numbers = [one for one in numbers if one not in held]
        some_kept = self._policy.keep_scans is KeptScans.DESCRIBED
        release = partial(removal.release, record=self._map, kept=self._policy.keep_scans, rules=self._rules)
        for some in portions(numbers, removal.WINDOWS if some_kept else removal.SUBMAPS):
            removed, freed = await self._removed(partial(release, numbers=some))
            self._tally.add(RetentionRule.SCANS, submaps=removed, bytes=freed)
        if numbers or anyway:
            await self._drop_scans(session_id)

    async def _drop_scans(self, session_id: str) -> None:
        rule = self._touched.get(session_id, RetentionRule.SCANS)
        read = partial(_unheld, record=self._map, session_id=session_id)
        while (found := await self._storage.read(read)) is not None:
            session, held, scans = found
            for some in portions(scans, removal.SCANS):
                await self._count_scans(rule, partial(removal.drop_scans, scans=some))
            if len(scans) < AT_A_TIME:
                await self._count_scans(rule, partial(removal.drop_last_cloud, session=session, held=held))
                return

    async def _count_scans(self, rule: RetentionRule, work: Callable[[UnitOfWork], Removed]) -> None:
        removed, freed = await self._removed(work)
        self._tally.add(rule, scans=removed, bytes=freed + removed * SCAN_ROW_BYTES)

    async def rejected_loops(self) -> None:
        """Delete the evidence of rejected pairs."""
        read = partial(_due_loops, record=self._map, policy=self._policy, now_ns=self._now_ns)
        after = 0
        while loops := await self._storage.read(partial(read, after=after)):
            after = loops[-1].number
            for some in portions(loops, removal.LOOPS):
                removed, freed = await self._removed(partial(removal.drop_loops, loops=some))
                bytes_ = freed + removed * PAIR_ROW_BYTES
                self._tally.add(RetentionRule.REJECTED_LOOPS, loop_closures=removed, bytes=bytes_)

    async def _removed(self, work: Callable[[UnitOfWork], Removed]) -> tuple[int, int]:
        """Do a part in one transaction: how many rows went, and the bytes of blobs that no row names any more.

        After it nothing is written for as long as it took.
        """
        began_s = time.perf_counter()
        removed = await self._storage.write(work)
        took_s = time.perf_counter() - began_s
        failpoint("delete.after_rows")
        unnamed = await self._storage.read(partial(_unnamed, tenant=self._map.tenant, blobs=removed.blobs))
        freed = await asyncio.to_thread(_weights, self._storage, self._map.tenant, unnamed)
        await asyncio.sleep(took_s)
        return removed.rows, freed

    async def noted(self) -> RetentionReport:
        """The report of the run; kept, told and audited where anything was removed."""
        report = RetentionReport(self._now_ns, self._tally.outcomes(), len(self.held_back), self._sessions_held)
        if report.rules:
            await self._storage.write(partial(_note, record=self._map, report=report))
            log.info("retention", tenant=self._map.tenant, map=self._map.map_id, rules=report.stored()["rules"])
        return report


def _map_page(uow: UnitOfWork, after: int) -> list[MapRecord]:
    return uow.maps.of_all_tenants(after=after, limit=MAPS_A_PAGE)


def _require_whole(uow: UnitOfWork, record: MapRecord) -> None:
    """Require that the map's policy and the ends of its sessions are those that were written. Raises DataLoss."""
    maps = uow.maps.damaged(record.tenant, map_id=record.map_id)
    sessions = uow.sessions.damaged(record.tenant, map_id=record.map_id)
    for table, numbers in (("maps", maps), ("sessions", sessions)):
        if numbers:
            raise DataLoss(f"row {numbers[0]} of {table} is damaged: `revisit doctor --full` names every such row")


def _active_sessions(uow: UnitOfWork, record: MapRecord) -> int:
    return uow.sessions.count(record.tenant, map_id=record.map_id, state=SessionState.ACTIVE.value)


def _sessions_of(uow: UnitOfWork, tenant: TenantId, numbers: Sequence[int]) -> set[str]:
    return {one.session_id for one in uow.submaps.found(tenant, numbers).values()}


def _session_ids(uow: UnitOfWork, record: MapRecord) -> set[str]:
    return uow.sessions.distinct(record.tenant, "session_id", map_id=record.map_id)


def _unheld(
    uow: UnitOfWork, record: MapRecord, session_id: str
) -> tuple[SessionRecord, HeldScans, list[ScanRecord]] | None:
    """A session, what holds its scans, and the first that nothing holds; None where it was deleted."""
    session = uow.sessions.get(record.tenant, record.map_id, session_id)
    if session is None:
        return None
    held = HeldScans.of(session, uow.submaps.standings(record.tenant, record.map_id, session_id), ())
    scans = (scan for page in due.scan_pages(uow, session) for scan in page if held.frees(scan))
    return session, held, list(islice(scans, AT_A_TIME))


def _due_loops(
    uow: UnitOfWork, record: MapRecord, policy: RetentionPolicy, now_ns: int, after: int
) -> list[LoopRecord]:
    return list(islice(due.due_loops(uow, record, policy, now_ns, after), AT_A_TIME))


def _unnamed(uow: UnitOfWork, tenant: TenantId, blobs: Collection[Blob]) -> list[Blob]:
    return [blob for blob in blobs if not naming(uow, tenant, blob)]


def _weights(storage: Storage, tenant: TenantId, blobs: Collection[Blob]) -> int:
    return sum(storage.blobs.disk_bytes(tenant, kind, sha256) for kind, sha256 in blobs)


def _note(uow: UnitOfWork, record: MapRecord, report: RetentionReport) -> None:
    current = uow.maps.get(record.tenant, record.map_id)
    if current is None or current.number != record.number:
        return
    uow.maps.replace(replace(current, retention_run=report.stored()))
    detail = {"rules": report.stored()["rules"]}
    entry = AuditEntry(record.tenant, removal.ACTOR, "retention_applied", f"maps/{record.map_id}", detail)
    audit.append(uow, report.at_ns, entry)
    uow.events.record(EventRecord(record.tenant, record.map_id, EventKind.RETENTION.value, record.map_id))
