"""Loops that wait for their chain: accepted once their drive has gone on far enough, or has ended.

Rules decide some of them earlier, with the loops of later submaps (`core.acceptance.chain`, docs/decisions/0337).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from revisit.core.acceptance import Station, is_decided_by_way
from revisit.core.pair_verdict import RejectionReason
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.records import LoopRecord
from revisit.service.domain.states import LoopEventKind, LoopState, SessionState, SubmapState
from revisit.service.features.loops.claims import evidence_without_waiting, rules_of, station
from revisit.service.features.loops.rows import Change, change_loop
from revisit.service.ports.transactions import UnitOfWork

WAITING: dict[str, Any] = {"state": LoopState.PROPOSED.value, "reason": RejectionReason.AWAITS_CHAIN.value}
"""The fields of a loop that waits for its chain."""


@dataclass(frozen=True)
class Reached:
    """The submap that a drive has reached, and how far apart its submaps are begun at least, metres."""

    latest: Station
    stride_m: float


def accept_decided(
    uow: UnitOfWork, tenant: TenantId, session: SessionKey, now_ns: int, reached: Reached | None = None
) -> int:
    """Accept the waiting loops of a session that nothing later can doubt; how many.

    All of them where the session has ended, so that no submap of it will have further loops; else those that it has
    left far behind where it has `reached`.
    """
    waiting = uow.loops.find(tenant, map_id=session.map_id, query_session_id=session.session_id, **WAITING)
    if not waiting:
        return 0
    decided = waiting if _has_ended(uow, tenant, session) else _left_behind(uow, waiting, reached)
    for loop in decided:
        evidence = evidence_without_waiting(loop.evidence)
        change = Change(LoopEventKind.VERIFIED, now_ns, details=rules_of(evidence))
        change_loop(uow, loop, change, state=LoopState.ACCEPTED.value, reason=None, evidence=evidence)
    return len(decided)


def _has_ended(uow: UnitOfWork, tenant: TenantId, key: SessionKey) -> bool:
    """Whether a session is finished, and no submap of it is left with loops to be searched for.

    The session is held: of the end of the session and of its last search the later one sees the other.
    """
    session = uow.sessions.get(tenant, key.map_id, key.session_id, hold=True)
    if session is None or session.state != SessionState.FINISHED:
        return False
    of_session = {"map_id": key.map_id, "session_id": key.session_id}
    unsearched = ({"state": SubmapState.QUEUED.value}, {"searched": False})
    return not any(uow.submaps.count(tenant, **of_session, **one) for one in unsearched)


def _left_behind(uow: UnitOfWork, waiting: list[LoopRecord], reached: Reached | None) -> list[LoopRecord]:
    if reached is None:
        return []
    queries = uow.submaps.numbered(waiting[0].tenant, sorted({loop.query_number for loop in waiting})[:_MOST_READ])
    return [
        loop
        for loop in waiting
        if loop.query_number in queries
        and is_decided_by_way(station(queries[loop.query_number]), reached.latest, reached.stride_m)
    ]


_MOST_READ = 1000
