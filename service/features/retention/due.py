"""What the policy of a map says should go now, and what holds it: reads only, for dry runs and removals alike."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from revisit.core.merge.evidence import in_time
from revisit.service.domain.events import AMBIGUOUS
from revisit.service.domain.records import LoopRecord, MapFileRecord, MapRecord, ScanRecord, SessionRecord
from revisit.service.domain.retention import DAY_NS, RetentionPolicy
from revisit.service.domain.states import LoopState, SessionState, SubmapState
from revisit.service.features.graph.released_maps import released_maps
from revisit.service.features.graph.session_poses import PackedSubmaps, unpack_loops
from revisit.service.features.retention.rules import LESS, PlacedView, RankedSubmap, last_views, retired
from revisit.service.ports.transactions import UnitOfWork

OVERRULED = "OVERRULED"
PAGE = 500
SCANS_A_PAGE = 2000

AWAITING = ({"state": LoopState.PROPOSED.value}, {"state": LoopState.REJECTED.value, "reason": AMBIGUOUS})
"""Loops that wait: proposals, for a person or their drive, and such as were rejected only because other poses fit."""

ENDS = ("query_number", "match_number")


@dataclass(frozen=True)
class UnderReview:
    """The numbers of submaps with a loop that waits for a decision. To look at it takes place and neural map: such
    submaps are not `retired`. Of those whose scans are not `released`, either, the decision may move the map.
    """

    retired: frozenset[int]
    released: frozenset[int]


def under_review(uow: UnitOfWork, record: MapRecord) -> UnderReview:
    """The ends of proposals and of ambiguous loops. Scans are held of proposals, of what a person has proposed, and of
    pairs that share no frame of the version in force: how the others lie, the map knows without a decision.
    """
    tenant, of_map = record.tenant, {"map_id": record.map_id}
    proposed, ambiguous = ([uow.loops.distinct(tenant, end, **of_map, **state) for end in ENDS] for state in AWAITING)
    by_hand = (uow.loops.distinct(tenant, end, **of_map, **AWAITING[1], manual=True) for end in ENDS)
    held = frozenset(_far_ends(uow, record)).union(*by_hand, *proposed)
    return UnderReview(frozenset().union(*proposed, *ambiguous), held)


def _far_ends(uow: UnitOfWork, record: MapRecord) -> Iterator[int]:
    """The ends of the ambiguous loops of a map whose two submaps share no frame of the version in force."""
    frames, after = _frames(uow, record), 0
    while page := uow.loops.rejected(record.tenant, record.map_id, [AMBIGUOUS], after=after, limit=PAGE):
        for loop in page:
            frame = frames.get(loop.query_number)
            if frame is None or frame != frames.get(loop.match_number):
                yield from (loop.query_number, loop.match_number)
        after = page[-1].number


def _frames(uow: UnitOfWork, record: MapRecord) -> dict[int, str]:
    """The frame of each submap of the version in force, by number."""
    rows = uow.session_poses.find(record.tenant, map_id=record.map_id, version=record.map_version)
    return {number: row.frame for row in rows for number in PackedSubmaps.of(row.submaps).numbers.tolist()}


@dataclass(frozen=True)
class DueSession:
    """A finished session whose time is over; `rests`: the map rests on it, so that it stays without its submaps."""

    session: SessionRecord
    rests: bool


def due_sessions(uow: UnitOfWork, record: MapRecord, policy: RetentionPolicy, now_ns: int) -> list[DueSession]:
    """The finished sessions of a map that have ended long enough ago, but for those that need nothing more."""
    if policy.session_days is None and policy.dropped_session_days is None:
        return []
    found = []
    for session in uow.sessions.find(record.tenant, map_id=record.map_id):
        if session.state != SessionState.FINISHED or session.finished_at_ns is None or _is_waited_for(uow, session):
            continue
        age_days = (now_ns - session.finished_at_ns) / DAY_NS
        aged = policy.session_days is not None and age_days >= policy.session_days
        dropped = policy.dropped_session_days is not None and age_days >= policy.dropped_session_days
        if aged or dropped:
            rests = map_rests_on(uow, session)
            if aged or not rests:
                found.append(DueSession(session, rests))
    return found


def _is_waited_for(uow: UnitOfWork, session: SessionRecord) -> bool:
    """Whether a submap of a session is not described yet, or has not all its loops."""
    standings = uow.submaps.standings(session.tenant, session.map_id, session.session_id)
    return any(one.state == SubmapState.QUEUED or not one.searched for one in standings)


def map_rests_on(uow: UnitOfWork, session: SessionRecord) -> bool:
    """Whether anything of a map would be another without a session: a frame of a version that it shares, a loop with
    another session, accepted or waiting for a decision, a merge that can be taken back, a published file.
    """
    tenant, map_id, session_id = session.tenant, session.map_id, session.session_id
    if any(session_id in file.sessions for file in uow.map_files.find(tenant, map_id=map_id)):
        return True
    merges = uow.map_merges.find(tenant, map_id=map_id, reverted_at_ns=None)
    return (
        any(session_id in merge.sessions for merge in merges)
        or _has_loops(uow, session)
        or any(_shares_frame(uow, session, version) for version in _versions(uow, session))
    )


def _versions(uow: UnitOfWork, session: SessionRecord) -> set[int]:
    of_session = {"map_id": session.map_id, "session_id": session.session_id}
    return uow.session_poses.distinct(session.tenant, "version", **of_session)


def _shares_frame(uow: UnitOfWork, session: SessionRecord, version: int) -> bool:
    of_version: dict[str, str | int] = {"map_id": session.map_id, "version": version}
    frames = uow.session_poses.distinct(session.tenant, "frame", **of_version, session_id=session.session_id)
    return any(uow.session_poses.count(session.tenant, **of_version, frame=frame) > 1 for frame in frames)


def _has_loops(uow: UnitOfWork, session: SessionRecord) -> bool:
    """Whether it has an accepted loop with another session, or any that waits for a decision."""
    of_map = {"map_id": session.map_id}
    for state in (*AWAITING, {"state": LoopState.ACCEPTED.value}):
        as_query = uow.loops.distinct(
            session.tenant, "match_session_id", **of_map, **state, query_session_id=session.session_id
        )
        as_match = uow.loops.distinct(
            session.tenant, "query_session_id", **of_map, **state, match_session_id=session.session_id
        )
        others = (as_query | as_match) - (set[str]() if state in AWAITING else {session.session_id})
        if others:
            return True
    return False


def described_in(uow: UnitOfWork, session: SessionRecord) -> list[int]:
    """The numbers of the submaps of a session that are in the index."""
    standings = uow.submaps.standings(session.tenant, session.map_id, session.session_id)
    return [one.number for one in standings if one.state == SubmapState.DESCRIBED]


def due_retirements(uow: UnitOfWork, record: MapRecord, policy: RetentionPolicy, within_m: float) -> list[int]:
    """The numbers of described submaps that are none of the best of their place, by the version in force.

    Those of drives that go on stay, as do those that such drives have loops with.
    """
    if policy.best_submaps is None or not record.map_version:
        return []
    ranked = _ranked(uow, record)
    gone = set(retired(ranked, policy.best_submaps, within_m)) - _in_use(uow, record)
    return sorted(gone)


def _in_use(uow: UnitOfWork, record: MapRecord) -> set[int]:
    """Submaps that the acceptance of an active drive's loops may ask for."""
    tenant, map_id, used = record.tenant, record.map_id, set[int]()
    for session in uow.sessions.find(tenant, map_id=map_id, state=SessionState.ACTIVE.value):
        used |= uow.loops.distinct(tenant, "match_number", map_id=map_id, query_session_id=session.session_id)
        used |= {one.number for one in uow.submaps.standings(tenant, map_id, session.session_id)}
    return used


def _ranked(uow: UnitOfWork, record: MapRecord) -> list[RankedSubmap]:
    """The described submaps of a map that its version in force knows."""
    standings = {
        one.number: one
        for one in uow.submaps.standings(record.tenant, record.map_id)
        if one.state == SubmapState.DESCRIBED
    }
    scores = _mean_scores(uow, record)
    return [
        RankedSubmap(number, *place, bool(one.flags), scores.get(number, 0.0), one.point_count)
        for number, place in _places(uow, record)
        if (one := standings.get(number)) is not None
    ]


def _places(
    uow: UnitOfWork, record: MapRecord
) -> Iterator[tuple[int, tuple[str, str | None, tuple[float, float, float]]]]:
    """The submaps of the version of a map in force: number, frame, storey and position in the frame, metres."""
    storeys = {one.session_id: one.storey for one in uow.sessions.find(record.tenant, map_id=record.map_id)}
    for row in uow.session_poses.find(record.tenant, map_id=record.map_id, version=record.map_version):
        packed = PackedSubmaps.of(row.submaps)
        for number, T_map_submap in zip(packed.numbers.tolist(), packed.T_map_submap, strict=True):
            x, y, z = T_map_submap[:3, 3].tolist()
            yield number, (row.frame, storeys.get(row.session_id), (x, y, z))


def due_maps(
    uow: UnitOfWork,
    record: MapRecord,
    policy: RetentionPolicy,
    edge_m: float,
    now_ns: int,
    *,
    retiring: Collection[int] = (),
    leaving: Collection[str] = (),
) -> list[int]:
    """The numbers of the retired submaps that keep their neural map no longer, by the version in force.

    Of the sessions whose days are over the newest neural map of each square of `edge_m` metres stays, whichever submap
    has it: so the surface of now, and of each moment since, is told by the last view of each place; and the newest
    without the copies of a merge that can be taken back, which takes their views with it. In a dry run submaps that are
    `retiring` count as retired, sessions `leaving` as gone.
    """
    if policy.retired_days is None or not record.map_version:
        return []
    old = _ended_before(uow, record, now_ns - int(policy.retired_days * DAY_NS))
    without = released_maps(uow, record.tenant, record.map_id)
    standings = {
        one.number: one
        for one in uow.submaps.standings(record.tenant, record.map_id)
        if one.state in (SubmapState.DESCRIBED, SubmapState.RETIRED)
        and one.number not in without
        and one.session_id in old - set(leaving)
    }
    gone = {one.number for one in standings.values() if one.state == SubmapState.RETIRED or one.number in retiring}
    if not gone:
        return []
    views = [
        PlacedView(number, *place, in_time(one.session_number, one.stamp_ns))
        for number, place in _places(uow, record)
        if (one := standings.get(number)) is not None
    ]
    stays = last_views(views, edge_m)
    for copied in _copied(uow, record):
        stays |= last_views((one for one in views if standings[one.number].session_id not in copied), edge_m)
    return sorted(gone.intersection(view.number for view in views) - stays)


def files(uow: UnitOfWork, record: MapRecord) -> list[MapFileRecord]:
    """The published files of a map, which name neural maps."""
    return uow.map_files.find(record.tenant, map_id=record.map_id)


def _copied(uow: UnitOfWork, record: MapRecord) -> Iterator[set[str]]:
    """The sessions that go with each merge of a map that can be taken back: its own, and those of later ones."""
    copied = set[str]()
    for merge in reversed(uow.map_merges.find(record.tenant, map_id=record.map_id, reverted_at_ns=None)):
        copied |= set(merge.sessions)
        yield copied


def _ended_before(uow: UnitOfWork, record: MapRecord, before_ns: int) -> set[str]:
    """The ids of the finished sessions of a map that had ended by then."""
    finished = uow.sessions.find(record.tenant, map_id=record.map_id, state=SessionState.FINISHED.value)
    return {one.session_id for one in finished if one.finished_at_ns is not None and one.finished_at_ns <= before_ns}


def _mean_scores(uow: UnitOfWork, record: MapRecord) -> dict[int, float]:
    """By number, the mean score of the accepted loops of a submap."""
    scores = defaultdict[int, list[float]](list)
    for page in loop_pages(uow, record, LoopState.ACCEPTED):
        for loop in page:
            scores[loop.query_number].append(loop.score)
            scores[loop.match_number].append(loop.score)
    return {number: float(np.mean(of_submap)) for number, of_submap in scores.items()}


def loop_pages(uow: UnitOfWork, record: MapRecord, state: LoopState, after: int = 0) -> Iterator[list[LoopRecord]]:
    """The loops of a map in a state with a number above `after`, oldest first, a page at a time."""
    tenant, map_id = record.tenant, record.map_id
    while page := uow.loops.find(tenant, after=after, limit=PAGE, map_id=map_id, state=state.value):
        yield page
        after = page[-1].number


def sessions_with_scans(uow: UnitOfWork, record: MapRecord, policy: RetentionPolicy) -> list[str]:
    """The ids of the sessions with submaps that keep more scans than the policy says."""
    ids = set[str]()
    for kept in LESS[policy.keep_scans]:
        ids |= uow.submaps.distinct(record.tenant, "session_id", map_id=record.map_id, kept_scans=kept.value)
    return sorted(ids)


def scan_pages(uow: UnitOfWork, session: SessionRecord) -> Iterator[list[ScanRecord]]:
    """The scans of a session in their order, a page at a time."""
    tenant, map_id, session_id, after = session.tenant, session.map_id, session.session_id, 0
    while page := uow.scans.find(tenant, after=after, limit=SCANS_A_PAGE, map_id=map_id, session_id=session_id):
        yield page
        after = page[-1].number


def due_loops(
    uow: UnitOfWork, record: MapRecord, policy: RetentionPolicy, now_ns: int, after: int = 0
) -> Iterator[LoopRecord]:
    """The rejected pairs of a map, with a number above `after`, that were judged long enough ago.

    Not those that wait for a decision, that a person has decided on or made, or that a version of the map names.
    """
    if policy.rejected_days is None:
        return
    before_ns, named = now_ns - int(policy.rejected_days * DAY_NS), _named_loops(uow, record)
    for page in loop_pages(uow, record, LoopState.REJECTED, after):
        for loop in page:
            if loop.created_at_ns > before_ns:
                return
            if not loop.manual and loop.reason not in (AMBIGUOUS, OVERRULED) and loop.number not in named:
                yield loop


def _named_loops(uow: UnitOfWork, record: MapRecord) -> set[int]:
    """The numbers of loops that a version of the map has a verdict on."""
    versions = uow.map_versions.find(record.tenant, map_id=record.map_id)
    return {loop.number for version in versions for loop in unpack_loops(version.loops)}
