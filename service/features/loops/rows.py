"""The history of loop closures: every change is an event, and the last one gives the state."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from revisit.service.domain.records import LoopEventRecord, LoopRecord, Pose
from revisit.service.domain.states import LoopEventKind, LoopState
from revisit.service.ports.transactions import UnitOfWork

SERVICE = "service"
"""The actor of changes that no person made."""


@dataclass(frozen=True)
class Change:
    """A change of a loop: kind, actor, note; `details` is JSON."""

    kind: LoopEventKind
    at_ns: int
    actor: str = SERVICE
    note: str = ""
    map_version: int = 0
    details: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class LoopStanding:
    """The fields of a loop that may change: verdict, its reason, the alignment, and the verdict of the pose graph."""

    state: LoopState
    reason: str | None
    T_match_query: Pose | None
    graph_state: str | None

    @classmethod
    def of(cls, record: LoopRecord | LoopEventRecord) -> LoopStanding:
        """As a loop's row has it, or as an event left it."""
        return cls(LoopState(record.state), record.reason, record.T_match_query, record.graph_state)


def before_last_decision(events: Iterable[LoopEventRecord]) -> LoopStanding | None:
    """The state of a loop before the last decision of a person that still holds; None where there is none.

    The verdict of the pose graph in it is that of then, and no longer of use.
    """
    standings: list[LoopStanding] = []
    for event in events:
        if event.kind in (LoopEventKind.VERIFIED, LoopEventKind.PROPOSED):
            standings = [LoopStanding.of(event)]
        elif event.kind in (LoopEventKind.ACCEPTED, LoopEventKind.REJECTED):
            standings.append(LoopStanding.of(event))
        elif event.kind == LoopEventKind.REVERTED:
            standings.pop()
    return standings[-2] if len(standings) > 1 else None


def decided_by_person(uow: UnitOfWork, loop: LoopRecord) -> bool:
    """Whether a person has ever decided on a loop."""
    by_person = {LoopEventKind.ACCEPTED, LoopEventKind.REJECTED, LoopEventKind.REVERTED}
    events = uow.loop_events.find(loop.tenant, map_id=loop.map_id, loop_id=loop.loop_id)
    return any(event.kind in by_person for event in events)


def add_loop(uow: UnitOfWork, record: LoopRecord, change: Change) -> LoopRecord:
    """Store a new loop with its first event."""
    added = uow.loops.add(record)
    uow.loop_events.add(_event(added, change))
    return added


def add_loops(uow: UnitOfWork, loops: Sequence[tuple[LoopRecord, Change]]) -> None:
    """Store new loops, each with its first event, in few statements: all other writers wait meanwhile."""
    uow.loops.add_all([loop for loop, _ in loops])
    uow.loop_events.add_all([_event(loop, change) for loop, change in loops])


def change_loop(uow: UnitOfWork, record: LoopRecord, change: Change, **fields: Any) -> LoopRecord:
    """Store a loop with changed fields, and the event that tells of it."""
    changed = replace(record, **fields)
    uow.loops.replace(changed)
    uow.loop_events.add(_event(changed, change))
    return changed


def change_loops(uow: UnitOfWork, changes: Sequence[tuple[LoopRecord, Change]], graph_state: str | None) -> None:
    """Store the same verdict of the pose graph on many loops, as they are stored, with the event of each.

    In few statements: a version of a map judges thousands of loops while all other writers wait.
    """
    uow.loops.revise([loop for loop, _ in changes], graph_state=graph_state)
    uow.loop_events.add_all([_event(replace(loop, graph_state=graph_state), change) for loop, change in changes])


def _event(loop: LoopRecord, change: Change) -> LoopEventRecord:
    return LoopEventRecord(
        tenant=loop.tenant,
        map_id=loop.map_id,
        loop_id=loop.loop_id,
        kind=change.kind.value,
        state=loop.state,
        reason=loop.reason,
        graph_state=loop.graph_state,
        T_match_query=loop.T_match_query,
        actor=change.actor,
        note=change.note,
        map_version=change.map_version,
        details=change.details,
        query_number=loop.query_number,
        match_number=loop.match_number,
        query_session_id=loop.query_session_id,
        match_session_id=loop.match_session_id,
        at_ns=change.at_ns,
    )
