"""Why a session has no loop: the first question of a team after its first drive."""

from __future__ import annotations

from dataclasses import dataclass

from revisit.core.config import LoopConfig
from revisit.service.domain.events import AWAITS_CHAIN
from revisit.service.domain.records import SessionRecord
from revisit.service.domain.states import SessionState, SubmapState
from revisit.service.features.catalogue.storeys import comparable_sessions
from revisit.service.ports.transactions import UnitOfWork

NO_SUBMAP = "NO_SUBMAP"
"""The drive was shorter than a submap."""

NOT_DESCRIBED = "NOT_DESCRIBED"
"""No submap of it could be described."""

NOTHING_TO_COMPARE = "NOTHING_TO_COMPARE"
"""It came back to no place that it had left, and there is no other session that it may be compared with."""

NONE_ACCEPTED = "NONE_ACCEPTED"
"""Pairs were compared, and none was accepted."""

_SUBMAPS_READ = 500


@dataclass(frozen=True)
class NoLoops:
    """Why a session has no loop: one of the codes above, and the same in words, with the figures."""

    code: str
    message: str


def why_no_loops(uow: UnitOfWork, session: SessionRecord, config: LoopConfig) -> NoLoops | None:
    """Why a finished session has no accepted loop, its own or another's; None where it has one, or may get one yet."""
    of_session = {"map_id": session.map_id, "session_id": session.session_id}
    waiting = ({"state": SubmapState.QUEUED.value}, {"searched": False})
    if session.state != SessionState.FINISHED or any(
        uow.submaps.count(session.tenant, **of_session, **one) for one in waiting
    ):
        return None
    count = uow.submaps.count(session.tenant, **of_session)
    if not count:
        return NoLoops(NO_SUBMAP, "no submap: nothing was stored of the drive")
    once = (SubmapState.DESCRIBED, SubmapState.RETIRED)
    if not any(uow.submaps.count(session.tenant, **of_session, state=state.value) for state in once):
        return NoLoops(NOT_DESCRIBED, f"{_submaps(count)}, none of which could be described")
    reasons = _reasons(uow, session)
    if None in reasons or AWAITS_CHAIN in reasons:
        return None
    if not reasons:
        return NoLoops(NOTHING_TO_COMPARE, f"{_submaps(count)}: {_nothing_to_compare(uow, session, config)}")
    often = max(reasons, key=lambda reason: (reasons[reason], str(reason)))
    compared = sum(reasons.values())
    return NoLoops(
        NONE_ACCEPTED,
        f"{_submaps(count)}: {compared} pairs were compared and none was accepted, most often for {often} "
        f"({reasons[often]}); revisit query --explain tells more",
    )


def _reasons(uow: UnitOfWork, session: SessionRecord) -> dict[str | None, int]:
    """How many loops that a submap of the session is in have each reason; None is that of accepted ones."""
    found: dict[str | None, int] = {}
    ordinal = -1
    while submaps := uow.submaps.path(session.tenant, session.map_id, session.session_id, ordinal, _SUBMAPS_READ):
        for reason, count in uow.loops.reasons(session.tenant, [one.number for one in submaps]).items():
            found[reason] = found.get(reason, 0) + count
        if None in found:
            break
        ordinal = submaps[-1].ordinal
    return found


def _nothing_to_compare(uow: UnitOfWork, session: SessionRecord, config: LoopConfig) -> str:
    left = f"the drive came back to no place that it had left by {config.leave_distance:g} m (leave_distance_m)"
    described = {"map_id": session.map_id, "state": SubmapState.DESCRIBED.value}
    own = uow.submaps.count(session.tenant, **described, session_id=session.session_id)
    others = uow.submaps.count(session.tenant, **described) - own
    if others and comparable_sessions(uow, session.tenant, session.map_id, session.storey) is not None:
        return f"{left}, and the other sessions of the map are on other storeys"
    return left if others else f"{left}, and the map has no other session to compare it with"


def _submaps(count: int) -> str:
    return "1 submap" if count == 1 else f"{count} submaps"
