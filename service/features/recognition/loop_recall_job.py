"""The job that tests rejected loops again after a new version of their map: recall.

Geometry rejects some pairs because registration started in the wrong place. Once a map has converged, it says how two
submaps lie to each other. Pairs that it puts near each other are registered again from there. The usual gates decide.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from revisit.core.acceptance import MOST_MOVED_M, Support, accept_chosen, accept_near, unsupported
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4, pose_matrix, pose_row
from revisit.core.pair_verdict import Authority, InitialPose, PairVerdict, RejectedLoop, VerifiedLoop
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import LoopRecord, MapRecord, SubmapRecord
from revisit.service.domain.states import LoopEventKind, LoopState, SubmapState
from revisit.service.failpoints import failpoint
from revisit.service.features.corrections.job import EarlyCorrections
from revisit.service.features.graph.doubted_loops import LOOPS_AT_ONCE
from revisit.service.features.graph.edits import note_edit
from revisit.service.features.graph.map_frames import LoopInMap, MapFrames
from revisit.service.features.graph.posting import optimise_soon
from revisit.service.features.index.comparison import Comparison
from revisit.service.features.index.place_memory import RecalledPlace
from revisit.service.features.loops.claims import (
    Evidence,
    claim_of_row,
    is_by_anchors,
    loop_state,
    revised_evidence,
    rules_of,
    support_evidence,
    unjudged,
    verdict_evidence,
)
from revisit.service.features.loops.rows import Change, LoopStanding, change_loop, decided_by_person
from revisit.service.features.operations.progress import OperationCancelled, Progress
from revisit.service.features.recognition.beside_anchors import ChosenLoop, loops_by_anchors
from revisit.service.features.recognition.beside_faults import MendedSteps, loops_beside_faults
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import CANCELLED, Lease
from revisit.service.ports.recogniser import PlaceRecogniser
from revisit.service.ports.storage import require_map
from revisit.service.ports.transactions import Transactions, UnitOfWork

RECALL = "recall"
"""The member of a loop's evidence for its second test: version of the map, and result."""

RECALLED_REASONS = frozenset({"NO_COMMON_REGION", "DEGENERATE_ALIGNMENT", "IMPLAUSIBLE_TILT", "LOW_OVERLAP",
                              "SEEN_THROUGH", "LOW_SCORE"})  # fmt: skip
"""Reasons that a wrong start of registration can have. Not those that hold from any start, nor AMBIGUOUS, which other
loops decide (docs/decisions/0161), but for those beside a fault of odometry (`beside_faults`)."""

MOST_RECALLED = 50
"""Loops, at most, that one version of a map gives another chance."""

_FROM = {False: "where the map has the two submaps", True: "the one of its poses where anchors put the two submaps"}

_LOST = "anchors had chosen its pose, and do not agree with it any more"

SAME_M = 0.5
SAME_RAD = np.radians(2.0)
"""A pair is tested again once its relative pose has moved by so much."""

_ROUNDING_M = 1e-6


@dataclass(frozen=True)
class RecalledLoop:
    """A rejected loop, its two submaps, how the map says they lie, and the verdict from there once it is known.

    ruled_out: the other poses T_match_query (4, 4) where anchors have chosen this one; None where the map says it.
    tags: those among these anchors.
    """

    map: MapRecord
    record: LoopRecord
    query: SubmapRecord
    match: SubmapRecord
    T_match_query: Matrix4
    ruled_out: tuple[Matrix4, ...] | None = None
    verdict: PairVerdict | None = None
    tags: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Found:
    map: MapRecord
    record: LoopRecord
    T_match_query: Matrix4
    ruled_out: tuple[Matrix4, ...] | None = None
    tags: tuple[str, ...] = ()


_Page = tuple[list[_Found], int | None]
"""Loops of a page, and where the next page begins; None after the last."""


class LoopRecallJob:
    """Registers rejected loops again from where the new version of their map has their submaps; all calls block."""

    def __init__(self, context: JobContext, recogniser: PlaceRecogniser, early: EarlyCorrections) -> None:
        """`early` corrects a map by the loops that hold."""
        self._context = context
        self._comparison = Comparison(context.blobs, recogniser)
        self._early = early

    def run(self, lease: Lease) -> None:
        """Test the loops of a map and store the verdicts; nothing where somebody cancels the operation."""
        context, tenant, map_id = self._context, lease.job.tenant, str(lease.job.payload["map_id"])
        try:
            progress = Progress(context.transactions, context.clock, lease)
            tested, lost = self._tested(tenant, map_id, progress)
        except OperationCancelled:
            context.complete(lease, CANCELLED)
            return
        failpoint("recall.before_commit")
        now_ns = context.clock.wall_ns()
        commit = RecallCommit(lease, context.policy, tested, lost, now_ns)
        if context.transactions.write(commit).result():
            self._early.update(tenant, map_id)

    def _tested(self, tenant: TenantId, map_id: str, progress: Progress) -> tuple[list[RecalledLoop], list[int]]:
        """The loops with their verdicts; and the numbers of those that anchors chose and no longer do."""
        transactions, policy = self._context.transactions, self._context.policy
        progress("READ_LOOPS")
        by_anchors = loops_by_anchors(transactions, policy, tenant, map_id, _was_tested)
        loops = loops_to_recall(transactions, policy, tenant, map_id, progress, by_anchors.chosen)
        tested = []
        for done, loop in enumerate(loops):
            progress("VERIFY_LOOPS", done, len(loops))
            tested.append(self._recalled(loop))
        return tested, by_anchors.lost

    def _recalled(self, loop: RecalledLoop) -> RecalledLoop:
        config, match = self._context.policy.for_map(loop.map), RecalledPlace(loop.match, loop.record.similarity)
        chosen = loop.ruled_out is not None
        initial = InitialPose(loop.T_match_query, Authority.DECIDES if chosen else Authority.COMPETES)
        verdict = self._comparison.verify(loop.query, match, config, initial)
        if chosen:
            return replace(loop, verdict=accept_chosen(verdict, loop.T_match_query, config.verification))
        return replace(loop, verdict=accept_near(verdict, loop.T_match_query, MOST_MOVED_M * loop.map.scene_scale))


def loops_to_recall(
    transactions: Transactions,
    policy: Policy,
    tenant: TenantId,
    map_id: str,
    progress: Progress,
    by_anchors: Sequence[ChosenLoop] = (),
) -> list[RecalledLoop]:
    """The loops of a map that its version in force gives another chance, the most similar first.

    Those beside faults of odometry and those that anchors choose come first. Read page by page, so that a large map
    holds up nobody.
    """
    chosen = []
    if by_anchors:
        chosen = transactions.read(partial(_chosen, tenant=tenant, map_id=map_id, by_anchors=by_anchors)).result()
    steps = MendedSteps()
    page = partial(_beside_faults, policy=policy, tenant=tenant, map_id=map_id, steps=steps)
    beside = _found(transactions, page, progress)
    near = _found(transactions, partial(_page, policy=policy, tenant=tenant, map_id=map_id), progress)
    best = [
        *islice(beside, 2 * MOST_RECALLED),
        *chosen,
        *heapq.nsmallest(
            2 * MOST_RECALLED, near, key=lambda one: (-one.record.similarity, -one.record.score, one.record.number)
        ),
    ]
    return transactions.read(partial(_undecided, tenant=tenant, best=best)).result()[:MOST_RECALLED]


def _chosen(uow: UnitOfWork, tenant: TenantId, map_id: str, by_anchors: Sequence[ChosenLoop]) -> list[_Found]:
    """The first of the loops that anchors choose."""
    record, some = uow.maps.get(tenant, map_id), by_anchors[: 2 * MOST_RECALLED]
    loops = uow.loops.numbered(tenant, [one.number for one in some])
    found = ((one, loops.get(one.number)) for one in some)
    return [
        _Found(record, loop, one.T_match_query, one.ruled_out, one.tags)
        for one, loop in found
        if record is not None and loop is not None
    ]


def _found(transactions: Transactions, page: Callable[..., _Page], progress: Progress) -> Iterator[_Found]:
    after: int | None = 0
    while after is not None:
        progress("READ_LOOPS")
        found, after = transactions.read(partial(page, after=after)).result()
        yield from found


def _beside_faults(
    uow: UnitOfWork, policy: Policy, tenant: TenantId, map_id: str, steps: MendedSteps, after: int
) -> _Page:
    """Ambiguous loops beside faults of odometry that the version in force has mended."""
    record = uow.maps.get(tenant, map_id)
    if record is None or not record.map_version:
        return [], None
    frames, rules = MapFrames(uow, tenant, map_id), policy.for_map(record).verification
    loops, following = loops_beside_faults(uow, record, frames, rules, steps, after)
    return [_Found(record, loop, T) for loop, T in loops if not _was_tested(loop, T)], following


def _page(uow: UnitOfWork, policy: Policy, tenant: TenantId, map_id: str, after: int) -> _Page:
    """Those of a page of rejected loops that are to be tested again; where the next begins, None after the last.

    Whole rows are read of loops alone that the map puts near each other: few, of many that are rejected.
    """
    record = uow.maps.get(tenant, map_id)
    if record is None or not record.map_version:
        return [], None
    rejected = uow.loops.rejected(tenant, map_id, sorted(RECALLED_REASONS), after=after, limit=LOOPS_AT_ONCE)
    frames, within_m = MapFrames(uow, tenant, map_id), policy.for_map(record).submap.tau
    placed = {
        number: T_match_query
        for number, loop in frames.loops(rejected).items()
        if _apart_m(loop) <= within_m + _ROUNDING_M
        and np.linalg.norm((T_match_query := _between(loop))[:3, 3]) <= within_m
    }
    found = [
        _Found(record, loop, placed[number])
        for number, loop in uow.loops.numbered(tenant, sorted(placed)).items()
        if _is_known(frames, loop, record) and not _was_tested(loop, placed[number])
    ]
    return found, rejected[-1].number if len(rejected) == LOOPS_AT_ONCE else None


def _apart_m(placed: LoopInMap) -> float:
    """How far apart the map has the two submaps, metres, but for rounding."""
    return math.dist(placed.query.T_map[3:12:4], placed.match.T_map[3:12:4])


def _between(placed: LoopInMap) -> Matrix4:
    """T_match_query by the map."""
    return np.asarray(se3.inverse(pose_matrix(placed.match.T_map)) @ pose_matrix(placed.query.T_map))


def _is_known(frames: MapFrames, loop: LoopRecord, record: MapRecord) -> bool:
    """Whether the map knows well enough how the two submaps lie."""
    spread_m = frames.spread_m(loop)
    return spread_m is not None and spread_m <= MOST_MOVED_M * record.scene_scale


def _was_tested(loop: LoopRecord, T_match_query: Matrix4) -> bool:
    """Whether a loop was tested again from about there."""
    evidence = loop.evidence.get(RECALL)
    return evidence is not None and _is_same(np.array(evidence["T_match_query"]).reshape(4, 4), T_match_query)


def _is_same(first: Matrix4, second: Matrix4) -> bool:
    """Whether two poses are the same as far as a test goes."""
    moved = np.asarray(se3.inverse(first) @ second)
    angle = float(np.arccos(np.clip(0.5 * (np.trace(moved[:3, :3]) - 1.0), -1.0, 1.0)))
    return float(np.linalg.norm(moved[:3, 3])) < SAME_M and angle < SAME_RAD


def _undecided(uow: UnitOfWork, tenant: TenantId, best: list[_Found]) -> list[RecalledLoop]:
    """Those that no person has ever decided on, with their submaps, which must both be in the index still."""
    numbers = {number for one in best for number in (one.record.query_number, one.record.match_number)}
    found = uow.submaps.numbered(tenant, sorted(numbers))
    submaps = {number: one for number, one in found.items() if one.state == SubmapState.DESCRIBED}
    return [
        RecalledLoop(
            one.map,
            one.record,
            submaps[one.record.query_number],
            submaps[one.record.match_number],
            one.T_match_query,
            one.ruled_out,
            tags=one.tags,
        )
        for one in best
        if {one.record.query_number, one.record.match_number} <= submaps.keys()
        and not decided_by_person(uow, one.record)
    ]


def _support(one: RecalledLoop) -> Evidence:
    """The evidence that anchors chose the pose of a loop; none where the map told it."""
    if one.ruled_out is None:
        return {}
    told = Support(0, 0, 0.0, one.ruled_out, on_earth=not one.tags, tags=one.tags)
    return {"support": support_evidence(told)}


def _as_read(loop: LoopRecord) -> tuple[int, LoopStanding, Any]:
    """Fields that must not have changed meanwhile: the loop, its standing, the result of an earlier test."""
    return loop.number, LoopStanding.of(loop), loop.evidence.get(RECALL)


@dataclass(frozen=True)
class RecallCommit:
    """The one transaction that ends a job of recall."""

    lease: Lease
    policy: Policy
    tested: list[RecalledLoop]
    lost: list[int]
    now_ns: int

    def __call__(self, uow: UnitOfWork) -> int:
        """Store the result of each loop that is still as it was read; how many are accepted since, or no longer.

        Raises StaleLease where another worker holds the job.
        """
        job = self.lease.job
        uow.maps.get(job.tenant, str(job.payload["map_id"]), hold=True)
        uow.queue.require(self.lease)
        accepted = sum(self._store(uow, one) for one in self.tested)
        lost = sum(self._withdraw(uow, number) for number in self.lost)
        if accepted or lost:
            optimise_soon(uow, job.tenant, str(job.payload["map_id"]), self.policy, self.now_ns)
        result = {"tested": len(self.tested), "accepted": accepted, **({"withdrawn": lost} if lost else {})}
        uow.queue.complete(self.lease, result)
        return accepted + lost

    def _withdraw(self, uow: UnitOfWork, number: int) -> bool:
        """Doubt a loop that anchors chose and do no longer; whether it was accepted until now."""
        tenant = self.lease.job.tenant
        loop = uow.loops.numbered(tenant, [number]).get(number)
        if loop is None or loop.state != LoopState.ACCEPTED or not is_by_anchors(loop) or decided_by_person(uow, loop):
            return False
        ends = uow.submaps.numbered(tenant, [loop.query_number, loop.match_number])
        if len(ends) < 2:
            return False
        claim = unsupported(claim_of_row(loop, ends[loop.query_number], ends[loop.match_number]), _LOST)
        rules = self.policy.for_map(require_map(uow, TenantId(tenant), loop.map_id)).verification
        evidence = {name: value for name, value in loop.evidence.items() if name != RECALL}
        note_edit(uow, TenantId(tenant), loop.map_id)  # what was corrected by it is taken back
        change = Change(LoopEventKind.VERIFIED, self.now_ns, note=_LOST)
        change_loop(
            uow,
            loop,
            change,
            state=loop_state(claim).value,
            reason=None if claim.reason is None else claim.reason.value,
            evidence=revised_evidence(evidence, claim, rules),
            graph_state=None,
        )
        return True

    def _store(self, uow: UnitOfWork, one: RecalledLoop) -> bool:
        """Accept a loop, or note that it was tested; whether it was accepted."""
        verdict, known = one.verdict, one.record
        loop = uow.loops.get(known.tenant, known.map_id, known.loop_id)
        if verdict is None or loop is None or _as_read(loop) != _as_read(known) or decided_by_person(uow, known):
            return False
        evidence = {**loop.evidence, RECALL: self._recall_evidence(one, verdict)}
        found = verdict_evidence(verdict, self.policy.for_map(one.map).verification)
        fields: dict[str, Any] = {"evidence": evidence}
        if isinstance(verdict, VerifiedLoop):
            fields = {
                "evidence": {
                    **unjudged(evidence),
                    **found,
                    **_support(one),
                    "model_version": one.query.model_version,
                },
                "state": LoopState.ACCEPTED.value,
                "reason": None,
                "score": float(verdict.measurement.score),
                "T_match_query": pose_row(verdict.measurement.T_match_query),
            }
        change_loop(uow, loop, self._change(one, verdict, found), **fields)
        return isinstance(verdict, VerifiedLoop)

    def _recall_evidence(self, one: RecalledLoop, verdict: PairVerdict) -> dict[str, Any]:
        return {
            "map_version": one.map.map_version,
            "T_match_query": list(pose_row(one.T_match_query)),
            "reason": verdict.reason.value if isinstance(verdict, RejectedLoop) else None,
            "before": one.record.reason,
        }

    def _change(self, one: RecalledLoop, verdict: PairVerdict, found: dict[str, Any]) -> Change:
        return Change(
            LoopEventKind.VERIFIED,
            self.now_ns,
            actor=f"map version {one.map.map_version}",
            note=f"tested again from {_FROM[one.ruled_out is not None]}, after {one.record.reason}",
            map_version=one.map.map_version,
            details={
                "model_version": one.query.model_version,
                **rules_of(found),
                RECALL: self._recall_evidence(one, verdict),
            },
        )
