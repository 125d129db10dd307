"""The two transactions of a description: the submap enters its map; its loops and the end of the job, together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from revisit.core.acceptance import LoopClaim
from revisit.core.config import VerificationConfig
from revisit.core.errors import DescriptorModelMismatch
from revisit.core.geometry.se3 import pose_row
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import LoopRecord, MapRecord, SubmapRecord
from revisit.service.domain.states import LoopEventKind, LoopState
from revisit.service.failpoints import failpoint
from revisit.service.features.deletion.rows import SUBMAP_DELETED
from revisit.service.features.graph.edits import note_edit
from revisit.service.features.graph.posting import optimise_soon
from revisit.service.features.index.place_memory import RecalledPlace
from revisit.service.features.ingest.rows import SubmapSource
from revisit.service.features.loops.claims import kept_evidence, loop_state, revised_evidence, rules_of, station
from revisit.service.features.loops.rows import (
    Change,
    LoopStanding,
    add_loops,
    change_loop,
    decided_by_person,
)
from revisit.service.features.loops.waiting import WAITING, Reached, accept_decided
from revisit.service.ports.blobs import Blob
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.recogniser import SubmapDescription
from revisit.service.ports.storage import require_map
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class DescriptionTask:
    """A submap to describe, as the database holds it; `radio` is its fingerprint, None where nobody told any."""

    submap: SubmapRecord
    source: SubmapSource
    map: MapRecord
    radio: bytes | None = None


@dataclass(frozen=True)
class JudgedPlace:
    """A recalled place and the claim that it is the place of the query."""

    place: RecalledPlace
    claim: LoopClaim


@dataclass(frozen=True)
class RevisedLoop:
    """A stored loop, as it was read, and its claim as it is judged now."""

    record: LoopRecord
    claim: LoopClaim


@dataclass(frozen=True)
class StoredDescription:
    """A description with durable blobs, and the row that names them; `put` stores them again."""

    row: SubmapRecord
    description: SubmapDescription
    blobs: tuple[Blob, ...]
    put: Callable[[], object]


@dataclass(frozen=True)
class Query:
    """A submap that has entered its map, which is as it was then; `place` where this run has described it."""

    submap: SubmapRecord
    map: MapRecord
    place: bytes | None = None
    timings_s: dict[str, float] = field(default_factory=dict)

    @property
    def asked(self) -> SubmapRecord | bytes:
        """The query of a comparison."""
        return self.submap if self.place is None else self.place


@dataclass(frozen=True)
class Entry:
    """The transaction in which a described submap enters its map: descriptor, state and change of the index."""

    lease: Lease
    map: MapRecord
    described: StoredDescription

    def __call__(self, uow: UnitOfWork) -> None:
        """Commit, or change nothing where the submap was deleted. Raises StaleLease, DescriptorModelMismatch."""
        # A late run must not trip over the rows of the run that overtook it.
        uow.queue.require(self.lease)
        row = self.described.row
        known = uow.submaps.get(row.tenant, row.map_id, row.session_id, row.submap_id, hold=True)
        if known is None or known.number != row.number:
            return
        current = require_map(uow, row.tenant, row.map_id)
        if current.model_version is None:
            current = require_map(uow, row.tenant, row.map_id, hold=True)
        if current.model_version not in (None, row.model_version):
            raise DescriptorModelMismatch(f"map {row.map_id} was described by model {current.model_version}")
        uow.blobs.refer(row.tenant, self.described.blobs)
        if current.model_version is None:
            uow.maps.replace(replace(current, model_version=row.model_version))
        uow.submaps.replace(replace(row, map_version=current.map_version))
        failpoint("merge.after_submap")
        uow.changes.record_described(self.map, row.number)


@dataclass(frozen=True)
class LoopCommit:
    """The transaction that ends a description; `revised` are earlier loops that this one's loops decide.

    Loops that have waited for this submap are accepted.
    """

    policy: Policy
    lease: Lease
    query: Query
    judged: list[JudgedPlace]
    revised: list[RevisedLoop]
    now_ns: int

    def __call__(self, uow: UnitOfWork) -> bool:
        """Commit; whether other loops are accepted since. Raises StaleLease where another worker holds the job."""
        own = self.query.submap
        of_session = {"map_id": own.map_id, "query_session_id": own.session_id}
        if self._passed or self.revised or uow.loops.count(own.tenant, **of_session, **WAITING):
            uow.maps.get(own.tenant, own.map_id, hold=True)
        uow.queue.require(self.lease)
        stored = uow.submaps.found(own.tenant, [own.number, *(item.place.submap.number for item in self.judged)])
        if own.number not in stored:
            self._end(uow, SUBMAP_DELETED)
            return False
        present = [item for item in self.judged if item.place.submap.number in stored]
        loops = [self._loop(item) for item in present]
        add_loops(uow, [(loop, self._verified(loop.evidence)) for loop in loops])
        uow.submaps.revise([own], searched=True)
        accepted = sum(item.claim.accepted for item in present)
        waiting = sum(item.claim.waits for item in present)
        others = accepted + sum(self._revise(uow, loop) for loop in self.revised) + self._decided(uow)
        if others:
            optimise_soon(uow, own.tenant, own.map_id, self.policy, self.now_ns)
        failpoint("merge.after_loops")
        timings = {stage: round(seconds, 4) for stage, seconds in self.query.timings_s.items()}
        result = {"submap": own.key.name, "loops_accepted": accepted, "loops_waiting": waiting}
        self._end(uow, {**result, "loops_rejected": len(present) - accepted - waiting, "timings_s": timings})
        return others > 0

    @property
    def _passed(self) -> bool:
        return any(item.claim.accepted or item.claim.waits for item in self.judged)

    def _decided(self, uow: UnitOfWork) -> int:
        """Accept the loops of the drive that have waited for this submap; how many."""
        own, stride_m = self.query.submap, self.policy.for_map(self.query.map).submap.stride
        session = own.key.session
        return accept_decided(uow, own.tenant, session, self.now_ns, Reached(station(own), stride_m))

    def _end(self, uow: UnitOfWork, result: dict[str, Any]) -> None:
        uow.queue.complete(self.lease, result)

    def _revise(self, uow: UnitOfWork, revised: RevisedLoop) -> bool:
        """Change the verdict of an earlier loop, if it still has the one that it was read with.

        Whether it is accepted since, or no longer.
        """
        known, claim = revised.record, revised.claim
        loop = uow.loops.get(known.tenant, known.map_id, known.loop_id)
        if loop is None or LoopStanding.of(loop) != LoopStanding.of(known) or claim.T_match_query is None:
            return False
        if loop.state == LoopState.ACCEPTED and decided_by_person(uow, loop):
            return False
        evidence = revised_evidence(loop.evidence, claim, self._rules)
        if loop.state == LoopState.ACCEPTED and not claim.accepted:
            note_edit(uow, loop.tenant, loop.map_id)  # what was corrected by it is taken back
        change_loop(
            uow,
            loop,
            self._verified(evidence),
            state=loop_state(claim).value,
            reason=None if claim.reason is None else claim.reason.value,
            score=claim.score,
            T_match_query=pose_row(claim.T_match_query),
            evidence=evidence,
            graph_state=loop.graph_state if claim.accepted else None,
        )
        return claim.accepted or loop.state == LoopState.ACCEPTED

    @property
    def _rules(self) -> VerificationConfig:
        return self.policy.for_map(self.query.map).verification

    def _verified(self, evidence: dict[str, Any]) -> Change:
        """The rules of a verdict: the model and the thresholds."""
        details = {"model_version": self.query.submap.model_version, **rules_of(evidence)}
        return Change(LoopEventKind.VERIFIED, self.now_ns, details=details)

    def _loop(self, item: JudgedPlace) -> LoopRecord:
        query, match, claim = self.query.submap, item.place.submap, item.claim
        return LoopRecord.between(
            query,
            match,
            loop_id=f"loop-{query.number}-{match.number}",
            state=loop_state(claim).value,
            reason=None if claim.reason is None else claim.reason.value,
            similarity=item.place.similarity,
            score=claim.score,
            T_match_query=None if claim.T_match_query is None else pose_row(claim.T_match_query),
            evidence={**kept_evidence(claim, self._rules), "model_version": self.query.submap.model_version},
            created_at_ns=self.now_ns,
        )
