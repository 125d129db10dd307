"""Events: a log of the changes in the maps, written in the transaction of the change.

A row names a resource; its content is read on request. A reader goes on behind the number of its last event, after a
lost connection or a restart, without loss and without doubles.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Protocol, TypeAlias, TypeVar

from revisit.core.pose_graph.graph import GraphState
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord, LoopRecord, MapVersionRecord
from revisit.service.domain.states import EventKind, LoopState, OperationKind

R = TypeVar("R", contravariant=True)

AMBIGUOUS = "AMBIGUOUS"
"""The reason of a loop closure that was rejected because other poses fit as well (docs/decisions/0080)."""

AWAITS_CHAIN = "AWAITS_CHAIN"
"""The reason of a proposed loop closure that waits for its drive to go on (docs/decisions/0337)."""

WAITED_FOR = frozenset({OperationKind.SEARCH_CLOUD.value, OperationKind.LOCALIZE.value, OperationKind.RELOCALISE.value})
"""Operations with a waiting client: they make no event."""


DAMAGED = -1
"""In place of a last number that cannot be read."""


@dataclass(frozen=True)
class EventRecord:
    """A row of the log: something became true of `subject`, the id of a loop or an operation, the number of a version,
    an anchor or a session, in a map.

    `number` is its place among the events of the map.
    """

    tenant: TenantId
    map_id: str
    kind: str
    subject: str
    number: int = 0


def forgotten_until(tenant: TenantId, map_id: str, number: int) -> EventRecord:
    """The sign that events of a map up to `number` are no longer kept."""
    return EventRecord(tenant, map_id, EventKind.FORGOTTEN.value, "", number)


class EventLog(Protocol):
    """The log of all maps. The numbers of a map grow in the order of the commits and are never used twice."""

    def record(self, event: EventRecord, *, accepts: bool = False) -> None:
        """Add a row, which gets the next number of its map with the commit; nothing where the map is gone by then.

        `accepts`: a loop was accepted, and its `seq` is that number.
        """
        ...

    def following(self, tenant: TenantId, map_id: str, number: int, limit: int) -> list[EventRecord]:
        """At most `limit` rows of a map above `number`, by number.

        The first is of the kind FORGOTTEN where some of them are no longer kept: it has the number of the last.
        """
        ...

    def last_numbers(self, maps: Collection[tuple[TenantId, str]]) -> dict[tuple[TenantId, str], int]:
        """The last number of each of these maps that is there, 0 for none, DAMAGED where it cannot be read."""
        ...

    def forget(self, kept: int) -> int:
        """Delete all but the last `kept` rows of each tenant; how many."""
        ...


ChangeOf: TypeAlias = Callable[[R | None, R], None]
"""Told of each change of a record, in its transaction: the record before, None where it is new, and after."""


def on_loop_change(log: EventLog) -> ChangeOf[LoopRecord]:
    """Records loop closures that are new or have another state or pose.

    Candidates that were rejected at once are no news, unless they are ambiguous. Of the verdicts of the pose graph,
    that a loop was set aside is news, or no longer is. A loop that waits for its chain is none.
    """

    def record(before: LoopRecord | None, after: LoopRecord) -> None:
        if after.reason == AWAITS_CHAIN:
            return
        if before is None:
            news = after.state != LoopState.REJECTED or after.reason == AMBIGUOUS
        else:
            shown = ("state", "reason", "T_match_query")
            news = any(getattr(before, name) != getattr(after, name) for name in shown)
            news |= before.graph_state != after.graph_state and GraphState.SET_ASIDE in (
                before.graph_state,
                after.graph_state,
            )
        if news:
            accepts = after.state == LoopState.ACCEPTED and (before is None or before.state != after.state)
            event = EventRecord(after.tenant, after.map_id, EventKind.LOOP_CLOSURE.value, after.loop_id)
            log.record(event, accepts=accepts)

    return record


def on_job_change(log: EventLog) -> ChangeOf[JobRecord]:
    """Records operations that are new or have another state, but for those that somebody waits for."""

    def record(before: JobRecord | None, after: JobRecord) -> None:
        known = None if before is None else before.state
        if known == after.state or after.kind in WAITED_FOR:
            return
        log.record(EventRecord(after.tenant, map_of(after.subject), EventKind.OPERATION.value, after.operation_id))

    return record


def on_version_change(log: EventLog) -> ChangeOf[MapVersionRecord]:
    """Records new versions of maps: with each, the corrections of their sessions are others."""

    def record(before: MapVersionRecord | None, after: MapVersionRecord) -> None:
        if before is None:
            log.record(EventRecord(after.tenant, after.map_id, EventKind.MAP_VERSION.value, str(after.version)))

    return record


def map_of(subject: str) -> str:
    """The id of the map that a resource is in, by its name; empty where it is in none."""
    collection, _, rest = subject.partition("/")
    return rest.partition("/")[0] if collection == "maps" else ""
