"""Watching a map: its events, those to come too."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial

from revisit.core.errors import DataLoss
from revisit.service.capacity.in_flight import Turns
from revisit.service.capacity.limits import BATCHES_AT_A_TIME
from revisit.service.domain.errors import NotFound
from revisit.service.domain.events import DAMAGED, EventRecord
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.records import JobRecord
from revisit.service.domain.states import EventKind
from revisit.service.features.anchors.calls import AnchorView, anchors_seen
from revisit.service.features.graph.told_changes import DriveChanges
from revisit.service.features.loops.calls import LoopClosureView
from revisit.service.features.optimisation.calls import MapVersionView, version_seen
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.retention.reports import RetentionReport
from revisit.service.features.waiting.event_tail import AGAIN_S, EventTail
from revisit.service.ports.storage import require_map
from revisit.service.ports.transactions import UnitOfWork

HEARTBEAT_S = 15.0
"""A watch of which there is nothing to tell says so after this long."""

BATCH = 100
"""Events that are read from the store at a time."""


@dataclass(frozen=True)
class DriveChangesView:
    """The session of a drive, and what it found changed."""

    session: SessionKey
    found: DriveChanges


@dataclass(frozen=True)
class EventView:
    """An event as clients see it: its resource as it stands when the event is told.

    OPENED is the first of every watch, with the number that it begins behind. FORGOTTEN says that events before it are
    no longer there: the lists have the present state of their resources.
    """

    number: int
    kind: EventKind
    map_id: str
    loop: LoopClosureView | None = None
    operation: JobRecord | None = None
    map_version: MapVersionView | None = None
    retention: RetentionReport | None = None
    anchor: AnchorView | None = None
    drive_changes: DriveChangesView | None = None


@dataclass(frozen=True)
class EventPage:
    """Events of a batch, and the number of the last row that was looked at for them."""

    events: list[EventView]
    seen: int


@dataclass(frozen=True)
class Events:
    """Watches the events of maps."""

    context: CallContext
    tail: EventTail
    turns: Turns = field(default_factory=lambda: Turns(BATCHES_AT_A_TIME))
    heartbeat_s: float = field(default=HEARTBEAT_S)

    async def watch(
        self, tenant: TenantId, map_id: str, after: int | None = None, kinds: frozenset[EventKind] = frozenset()
    ) -> AsyncIterator[EventView | None]:
        """The events of a map with a number above `after`, those to come too; None where nothing happened for long.

        Without `after` from now on; with 0, all that are kept. `kinds` keeps those of these kinds, all where empty. An
        event that is followed by another of the same resource before it is told is left out. The first is OPENED. Ends
        when the service stops. Raises NotFound for the map, also once it is deleted.
        """
        last = await self.context.storage.read(partial(_last, tenant=tenant, map_id=map_id))
        seen = last if after is None else min(after, last)
        yield EventView(seen, EventKind.OPENED, map_id)
        if after is not None and after > last:
            # Never given out: the client has seen events of a database that was replaced by an older one since.
            yield EventView(seen, EventKind.FORGOTTEN, map_id)
        silent_s = 0.0
        while not self.context.admission.stopping:
            if last > seen:
                # A watch with much to catch up on does not keep every reader of the database.
                async with self.turns.of(tenant):
                    page = await self.context.storage.read(
                        partial(_page, tenant=tenant, map_id=map_id, seen=seen, last=last)
                    )
                seen = page.seen
                for event in page.events:
                    if not kinds or event.kind in kinds | {EventKind.FORGOTTEN}:
                        silent_s = 0.0
                        yield event
                continue
            began_s = asyncio.get_running_loop().time()
            last = await self.tail.beyond(tenant, map_id, seen, min(AGAIN_S, self.heartbeat_s - silent_s))
            silent_s += asyncio.get_running_loop().time() - began_s
            if silent_s >= self.heartbeat_s:
                silent_s = 0.0
                yield None


def _last(uow: UnitOfWork, tenant: TenantId, map_id: str) -> int:
    require_map(uow, tenant, map_id)
    last = uow.events.last_numbers([(tenant, map_id)])[tenant, map_id]
    if last == DAMAGED:
        raise DataLoss(f"the numbers of the events of map {map_id!r} are damaged"[:200])
    return last


def _page(uow: UnitOfWork, tenant: TenantId, map_id: str, seen: int, last: int) -> EventPage:
    require_map(uow, tenant, map_id)
    rows = uow.events.following(tenant, map_id, seen, BATCH)
    return EventPage(events_of(uow, rows), last if len(rows) < BATCH else rows[-1].number)


def events_of(uow: UnitOfWork, rows: Iterable[EventRecord]) -> list[EventView]:
    """The events of rows of one map, in their order: the last of each resource, none of one that is gone."""
    newest = sorted({(row.kind, row.subject): row for row in rows}.values(), key=lambda row: row.number)
    told = [_event_of(uow, row) for row in newest if row.kind != EventKind.ANCHOR]
    told += _of_anchors(uow, [row for row in newest if row.kind == EventKind.ANCHOR])
    return sorted((event for event in told if event is not None), key=lambda event: event.number)


def _of_anchors(uow: UnitOfWork, rows: Sequence[EventRecord]) -> list[EventView | None]:
    """The events of anchors of one map, whose verdicts are read together."""
    if not rows:
        return []
    tenant, map_id = rows[0].tenant, rows[0].map_id
    known = anchors_seen(uow, tenant, map_id, [int(row.subject) for row in rows])
    seen = [(row, known.get(int(row.subject))) for row in rows]
    return [EventView(row.number, EventKind.ANCHOR, map_id, anchor=one) for row, one in seen if one is not None]


def _event_of(uow: UnitOfWork, row: EventRecord) -> EventView | None:
    """The event of a row, None where its resource is gone."""
    kind = EventKind(row.kind)
    if kind is EventKind.LOOP_CLOSURE:
        loop = uow.loops.get(row.tenant, row.map_id, row.subject)
        return None if loop is None else EventView(row.number, kind, row.map_id, loop=LoopClosureView.of(loop))
    if kind is EventKind.OPERATION:
        job = uow.jobs.get(row.tenant, row.subject)
        return None if job is None else EventView(row.number, kind, row.map_id, operation=job)
    if kind is EventKind.MAP_VERSION:
        try:
            version = version_seen(uow, row.tenant, row.map_id, int(row.subject))
        except NotFound:
            return None
        return EventView(row.number, kind, row.map_id, map_version=version)
    if kind is EventKind.RETENTION:
        found = uow.maps.get(row.tenant, row.map_id)
        report = None if found is None else RetentionReport.of(found.retention_run)
        return None if report is None else EventView(row.number, kind, row.map_id, retention=report)
    if kind is EventKind.MAP_CHANGED:
        session = uow.sessions.numbered(row.tenant, [int(row.subject)]).get(int(row.subject))
        if session is None or session.changes_told is None:
            return None
        view = DriveChangesView(session.key, DriveChanges.of(session.changes_told))
        return EventView(row.number, kind, row.map_id, drive_changes=view)
    return EventView(row.number, kind, row.map_id)
