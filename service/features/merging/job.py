"""Merging a map, or a session of it, into another map, by a worker."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.merge.evidence import MergeEvidence, MergeRefusal, loops_refusal, surfaces_refusal
from revisit.core.pair_verdict import InitialPose, PairVerdict, RejectedLoop, RejectionReason, VerifiedLoop
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import SubmapRecord
from revisit.service.failpoints import failpoint
from revisit.service.features.graph.join_audit import JoinAudit
from revisit.service.features.index.comparison import Comparison
from revisit.service.features.index.place_memory import RecalledPlace
from revisit.service.features.merging.portions import VerdictsSoFar
from revisit.service.features.merging.reading import MergeOrder, MergeTask, read_merge, require_comparable
from revisit.service.features.merging.rows import NOTHING_TO_MERGE, MergeCommit
from revisit.service.features.merging.rules import (
    CrossingLoop,
    MergeProposal,
    chosen,
    placed_maps,
    track_loop,
)
from revisit.service.features.operations.progress import OperationCancelled, Progress
from revisit.service.features.operations.unchanged import unchanged
from revisit.service.ports.blobs import NEURAL_MAP_BLOB
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import CANCELLED, Lease
from revisit.service.ports.map_merger import AlignedMaps, MapMerger
from revisit.service.ports.map_optimiser import MapOptimiser
from revisit.service.ports.recogniser import PlaceRecogniser

CANDIDATES = 3
"""Of each submap in the other map: loops are needed along the common track, not of every submap."""

MOST_PAIRS = 1_000
"""Pairs of submaps that are verified, the likest first: 0.04 s of a core each."""


@dataclass(frozen=True)
class _Run:
    """One run of a job."""

    lease: Lease
    order: MergeOrder
    progress: Progress
    verdicts: VerdictsSoFar

    @classmethod
    def of(cls, context: JobContext, lease: Lease) -> _Run:
        """Of a leased job."""
        progress = Progress(context.transactions, context.clock, lease)
        verdicts = VerdictsSoFar(context, lease.job, progress, MOST_PAIRS)
        return cls(lease, MergeOrder.of(lease.job.payload), progress, verdicts)

    @property
    def tenant(self) -> TenantId:
        """Of the maps."""
        return self.lease.job.tenant


class MapMerging:
    """Runs the jobs that merge maps; all calls block."""

    def __init__(
        self, context: JobContext, recogniser: PlaceRecogniser, optimiser: MapOptimiser, merger: MapMerger
    ) -> None:
        """`recogniser` verifies two places, `merger` compares two maps; `optimiser` solves each of them before."""
        self._context = context
        self._comparison = Comparison(context.blobs, recogniser)
        self._merger = merger
        self._audit = JoinAudit(context, optimiser, merger)

    def run(self, lease: Lease) -> None:
        """Read both maps, find out whether they are one, commit the merge or say why not.

        Raises DescriptorModelMismatch; Unavailable where the maps change all the time; OutOfTurn after a portion.
        """
        run = _Run.of(self._context, lease)
        try:
            unchanged(partial(self._ended, run), "the maps were changed again and again while they were compared")
        except OperationCancelled:
            self._context.complete(lease, CANCELLED)
        run.verdicts.forget()

    def _ended(self, run: _Run) -> bool:
        """One reading of both maps: whether the job has ended by it."""
        run.progress("READ_MAPS")
        read = partial(read_merge, policy=self._context.policy, tenant=run.tenant, order=run.order)
        task = self._context.transactions.read(read).result()
        if task is None:
            self._context.complete(run.lease, NOTHING_TO_MERGE)
            return True
        require_comparable(task.target.task.map, task.source.task.map)
        proposal = self._proposal(run, task)
        failpoint("map_merge.after_evidence")
        if run.order.validate_only or proposal.refusal is not None:
            self._context.complete(run.lease, proposal.report())
            return True
        run.progress("COMMIT")
        now_ns = self._context.clock.wall_ns()
        commit = MergeCommit(run.lease, proposal, self._context.policy, now_ns)
        return self._context.transactions.write(commit).result()

    def _audited(self, task: MergeTask, progress: Progress) -> MergeTask:
        """The task with the joins within each of the maps that surfaces speak against."""
        sides = (replace(one, refused=self._audit.refused(one.task, progress)) for one in (task.target, task.source))
        return MergeTask(*sides)

    def _proposal(self, run: _Run, read: MergeTask) -> MergeProposal:
        config, progress = self._context.policy.for_map(read.target.task.map), run.progress
        crossing = tuple(self._crossing(run, read, config))
        run.verdicts.store()
        task = self._audited(read, progress)
        best, others = chosen(crossing)
        numbers = {-place: one for place, one in enumerate(best, 1)}
        loops = tuple(track_loop(number, one) for number, one in numbers.items())
        spare = tuple(track_loop(-place, one) for place, one in enumerate(others, 1 + len(best)))
        against = task.against((*loops, *spare))
        loops, spare = (tuple(one for one in some if one.number not in against) for some in (loops, spare))
        numbers = {one.number: numbers[one.number] for one in loops}
        progress("ALIGN")
        sessions, scale = frozenset(task.source.sessions), config.scene_scale
        aligned = self._merger.align(task.graph(loops), sessions, spare, scale, progress)
        limits, surfaces = self._merger.limits.scaled(scale), None
        refusal = loops_refusal(aligned.joining, limits)
        if refusal is not None and len(against) >= limits.loops:
            refusal = MergeRefusal.ANCHORS_DISAGREE
        if refusal is None:
            surfaces = self._surfaces(run.tenant, task, aligned, scale, progress)
            refusal = surfaces_refusal(surfaces, limits)
        return MergeProposal(run.order, task, crossing, numbers, aligned, surfaces, limits, refusal)

    def _surfaces(
        self, tenant: TenantId, task: MergeTask, aligned: AlignedMaps, scale: float, progress: Progress
    ) -> MergeEvidence:
        """The surfaces of both maps, each in the frame of the one that grows."""
        tracks, anchors = aligned.optimised.tracks, set(task.target.sessions)
        first, second = (placed_maps(side, tracks, anchors) for side in (task.target, task.source))
        read = partial(self._context.blobs.get, tenant, NEURAL_MAP_BLOB)
        return self._merger.compare(first, second, read, scale, progress)

    def _crossing(self, run: _Run, task: MergeTask, config: PipelineConfig) -> Iterator[CrossingLoop]:
        """Candidates between both maps with the verdicts on them, the likest first."""
        order = run.order
        run.progress("FIND_CANDIDATES")
        found = self._merger.candidates(task.target.places, task.source.places, CANDIDATES)
        near = [(one, other, cosine) for one, other, cosine in found if _may_meet(order, task, one, other)][:MOST_PAIRS]
        for done, (one, other, cosine) in enumerate(near):
            run.progress("VERIFY_LOOPS", done, len(near))
            match, query = task.target.submaps[one], task.source.submaps[other]
            expected = _expected(order, task, one, other)
            pose = None if expected is None else expected.tobytes()
            rests_on = query.place_sha256, match.place_sha256, cosine, pose, config
            verify = partial(self._verified, query, RecalledPlace(match, cosine), config, expected)
            verdict = run.verdicts.verdict(rests_on, verify)
            yield CrossingLoop(query, match, cosine, _within(order, verdict, expected))

    def _verified(
        self, query: SubmapRecord, match: RecalledPlace, config: PipelineConfig, expected: Matrix4 | None
    ) -> PairVerdict:
        """The verdict of geometry on two places; the initial pose chooses among several alignments that fit."""
        verdict = self._comparison.verify(query, match, config)
        if _is_ambiguous(verdict) and expected is not None:
            return self._comparison.verify(query, match, config, InitialPose(expected))
        return verdict


def _is_ambiguous(verdict: PairVerdict) -> bool:
    return isinstance(verdict, RejectedLoop) and verdict.reason == RejectionReason.AMBIGUOUS


def _expected(order: MergeOrder, task: MergeTask, match: int, query: int) -> Matrix4 | None:
    """T_match_query by the initial pose, None without one or where it says nothing of the two."""
    if order.near is None:
        return None
    T_map_match, T_source_query = task.target.T_map_submap[match], task.source.T_map_submap[query]
    T_match_query = np.linalg.inv(T_map_match) @ order.near @ T_source_query if np.isfinite(T_map_match).all() else None
    return T_match_query if T_match_query is not None and np.isfinite(T_match_query).all() else None


def _may_meet(order: MergeOrder, task: MergeTask, match: int, query: int) -> bool:
    """Whether the initial pose, if there is one, puts two submaps within its radius of each other."""
    if order.near is None or order.radius_m is None:
        return True
    expected = _expected(order, task, match, query)
    return expected is not None and bool(np.linalg.norm(expected[:3, 3]) <= order.radius_m)


def _within(order: MergeOrder, verdict: PairVerdict, expected: Matrix4 | None) -> PairVerdict:
    """The verdict, rejected where it puts the submaps farther than the radius from where the initial pose has them."""
    if expected is None or order.radius_m is None or not isinstance(verdict, VerifiedLoop):
        return verdict
    apart = se3.inverse(expected) @ verdict.measurement.T_match_query
    if np.linalg.norm(apart[:3, 3]) <= order.radius_m:
        return verdict
    return RejectedLoop(RejectionReason.FAR_FROM_INITIAL_POSE, verdict.measurement)
