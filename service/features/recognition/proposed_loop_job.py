"""The job that verifies a loop which a person has proposed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from revisit.core.acceptance import LoopClaim, accept_named
from revisit.core.geometry.se3 import pose_matrix, pose_row
from revisit.core.pair_verdict import Authority, InitialPose, PairVerdict, RejectionReason, VerifiedLoop
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import JobRecord, LoopRecord, MapRecord, SubmapRecord
from revisit.service.domain.states import LoopEventKind, LoopState
from revisit.service.features.corrections.job import EarlyCorrections
from revisit.service.features.graph.posting import optimise_soon
from revisit.service.features.index.comparison import Comparison
from revisit.service.features.index.place_memory import RecalledPlace
from revisit.service.features.loops.claims import claim_of_row, evidence_of, loop_state, poses_of, rules_of, station
from revisit.service.features.loops.decisions import OVERRULED
from revisit.service.features.loops.rows import Change, change_loop
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.recogniser import PlaceRecogniser
from revisit.service.ports.storage import require_descriptor, require_map
from revisit.service.ports.transactions import UnitOfWork

NO_LONGER_PROPOSED = {"outcome": "the loop was deleted, or somebody decided on it meanwhile"}
"""The result of a job that had nothing left to verify."""


@dataclass(frozen=True)
class ProposedPair:
    """The submaps of a proposed loop, how alike they are, and the pose that somebody named, if so."""

    map: MapRecord
    query: SubmapRecord
    match: RecalledPlace
    initial: InitialPose | None


@dataclass(frozen=True)
class VerdictCommit:
    """The one transaction that ends the verification of a proposed loop."""

    lease: Lease
    policy: Policy
    pair: ProposedPair | None
    verdict: PairVerdict | None
    now_ns: int

    def __call__(self, uow: UnitOfWork) -> None:
        """Commit. Raises StaleLease where another worker holds the job."""
        job = self.lease.job
        uow.maps.get(job.tenant, str(job.payload["map_id"]), hold=True)
        uow.queue.require(self.lease)
        loop = _proposed(uow, self.lease.job)
        if loop is None or self.pair is None or self.verdict is None:
            uow.queue.complete(self.lease, NO_LONGER_PROPOSED)
            return
        verdict, measured = self.verdict, self.verdict.measurement
        rules = self.policy.for_map(self.pair.map).verification
        query, match = self.pair.query, self.pair.match.submap
        known = [*_known(uow, query, match), *_known(uow, match, query)]
        claim = accept_named(LoopClaim(station(query), station(match), verdict), known, rules)
        state, reason = loop_state(claim), None if claim.reason is None else claim.reason.value
        evidence = evidence_of(claim, rules)
        model = {"model_version": self.pair.query.model_version}
        change_loop(
            uow,
            loop,
            Change(LoopEventKind.VERIFIED, self.now_ns, details={**model, **rules_of(evidence)}),
            state=state.value,
            reason=reason,
            similarity=self.pair.match.similarity,
            score=0.0 if measured is None else float(measured.score),
            T_match_query=loop.T_match_query if measured is None else pose_row(measured.T_match_query),
            evidence={**evidence, **model},
        )
        if claim.accepted:
            optimise_soon(uow, loop.tenant, loop.map_id, self.policy, self.now_ns)
        result = {"loop_closure": f"maps/{loop.map_id}/loopClosures/{loop.loop_id}", "state": state.value}
        uow.queue.complete(self.lease, {**result, "reason": reason})


class ProposedLoopJob:
    """Verifies proposed loops; all calls block."""

    def __init__(self, context: JobContext, recogniser: PlaceRecogniser, early: EarlyCorrections) -> None:
        """`early` corrects a map by the loops that hold."""
        self._context = context
        self._comparison = Comparison(context.blobs, recogniser)
        self._early = early

    def run(self, lease: Lease) -> None:
        """Register the two submaps of a loop and store the verdict."""
        context = self._context
        pair = context.transactions.read(partial(_proposed_pair, job=lease.job)).result()
        verdict = None
        if pair is not None:
            verdict = self._comparison.verify(pair.query, pair.match, context.policy.for_map(pair.map), pair.initial)
        now_ns = context.clock.wall_ns()
        commit = VerdictCommit(lease, context.policy, pair, verdict, now_ns)
        context.transactions.write(commit).result()
        if pair is not None and isinstance(verdict, VerifiedLoop):
            self._early.update(pair.map.tenant, pair.map.map_id)


def _proposed_pair(uow: UnitOfWork, job: JobRecord) -> ProposedPair | None:
    """The pair to verify; None where it is gone, or no longer a proposal."""
    loop = _proposed(uow, job)
    if loop is None:
        return None
    submaps = uow.submaps.numbered(job.tenant, [loop.query_number, loop.match_number])
    query, match = submaps[loop.query_number], submaps[loop.match_number]
    initial = None
    if loop.T_match_query is not None:
        initial = InitialPose(np.array(pose_matrix(loop.T_match_query)), Authority.COMPETES)
    recalled = RecalledPlace(match, _similarity(query, match))
    return ProposedPair(require_map(uow, job.tenant, loop.map_id), query, recalled, initial)


def _known(uow: UnitOfWork, query: SubmapRecord, match: SubmapRecord) -> list[LoopClaim]:
    """The claims on a pair that are or were ambiguous, also those that a person has decided, or tried before."""
    found = uow.loops.find(query.tenant, query_number=query.number, match_number=match.number)
    was = [loop for loop in found if loop.T_match_query is not None and _was_ambiguous(loop)]
    as_before = [
        replace(one, reason=RejectionReason.AMBIGUOUS.value) if one.reason == OVERRULED else one for one in was
    ]
    return [claim_of_row(loop, query, match) for loop in as_before]


def _was_ambiguous(loop: LoopRecord) -> bool:
    """Whether a loop is ambiguous, or was before it was accepted, or a person rejected it."""
    if loop.state == LoopState.ACCEPTED or loop.reason == OVERRULED:
        return len(poses_of(loop)) > 1 or bool(loop.evidence.get("doubts"))
    return loop.reason == RejectionReason.AMBIGUOUS


def _proposed(uow: UnitOfWork, job: JobRecord) -> LoopRecord | None:
    loop = uow.loops.get(job.tenant, str(job.payload["map_id"]), str(job.payload["loop_id"]))
    return loop if loop is not None and loop.state == LoopState.PROPOSED else None


def _similarity(query: SubmapRecord, match: SubmapRecord) -> float:
    first, second = (np.frombuffer(require_descriptor(one), dtype="<f4").astype(np.float64) for one in (query, match))
    return float(first @ second)
