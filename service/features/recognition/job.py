"""The job that describes a submap and closes its loops.

First the description enters the index of the map, in a transaction that gives it the number of a change. Then the job
searches among the submaps that entered before it, and commits its loops with its end. Of two submaps that two workers
describe at the same time the one that entered later finds the other. A run that finds its submap entered goes on from
the stored description (docs/decisions/0325).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from revisit.core.acceptance import Decided, LoopClaim, PredictedPoses, accept, verify_in_turn
from revisit.core.config import PipelineConfig
from revisit.core.pair_verdict import InitialPose, PairVerdict
from revisit.core.submap import Submap
from revisit.service.domain.identity import SubmapKey, TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import JobRecord, LoopRecord, SubmapRecord
from revisit.service.domain.states import SubmapState
from revisit.service.failpoints import failpoint
from revisit.service.features.catalogue.maps import model_for_map
from revisit.service.features.catalogue.storeys import comparable_sessions, storey_of
from revisit.service.features.corrections.job import EarlyCorrections
from revisit.service.features.deletion.rows import SUBMAP_DELETED
from revisit.service.features.index.comparison import Comparison, require_same_model
from revisit.service.features.index.own_drive import candidates_of
from revisit.service.features.index.place_memory import PlaceMemory, RecalledPlace
from revisit.service.features.ingest.rows import each_scan, load_submap, submap_source
from revisit.service.features.loops.claims import station
from revisit.service.features.radio.rows import fingerprint_of
from revisit.service.features.recognition.rows import (
    DescriptionTask,
    Entry,
    JudgedPlace,
    LoopCommit,
    Query,
    RevisedLoop,
    StoredDescription,
)
from revisit.service.features.recognition.stations import stations_in_map
from revisit.service.features.recognition.turns import drive_in_turn
from revisit.service.ports.blobs import NEURAL_MAP_BLOB, PLACE_BLOB
from revisit.service.ports.index import VectorFilter
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.recogniser import PlaceRecogniser, SubmapDescription
from revisit.service.ports.storage import require_descriptor, require_map
from revisit.service.ports.transactions import UnitOfWork

T = TypeVar("T")

INSPECTED_FIRST = 3
INSPECTED_EVERY = 20
"""Mistakes about units, frames and times run through a session: its first submaps are inspected, then some."""


class SubmapDescriptionJob:
    """Describes submaps; all calls block."""

    def __init__(
        self, context: JobContext, memory: PlaceMemory, recogniser: PlaceRecogniser, early: EarlyCorrections
    ) -> None:
        """`memory` searches this worker's own index; `early` corrects a map by the loops found."""
        self._context = context
        self._memory = memory
        self._recogniser = recogniser
        self._comparison = Comparison(context.blobs, recogniser)
        self._early = early

    def run(self, lease: Lease) -> None:
        """Describe and enter, search, verify and commit. Raises RevisitError where the submap cannot be described.

        Raises OutOfTurn where loops that the rules ask for are not there yet, and another run of theirs has to begin.
        """
        task = self._read(_task, lease)
        if task is None:
            self._context.complete(lease, SUBMAP_DELETED)
            return
        require_same_model(task.map, self._recogniser)
        config = self._context.policy.for_map(task.map)
        described = None
        if task.submap.state != SubmapState.DESCRIBED:
            described = self._described(lease, task, config)
        query = self._read(_entered, lease, described)
        if query is None:
            self._context.complete(lease, SUBMAP_DELETED)
        else:
            self._close_loops(lease, query, config)

    def _read(self, read: Callable[..., T], lease: Lease, *further: object) -> T:
        policy = self._context.policy
        return self._context.transactions.read(lambda uow: read(uow, policy, lease.job, *further)).result()

    def _described(self, lease: Lease, task: DescriptionTask, config: PipelineConfig) -> SubmapDescription:
        """The description of a submap, which has entered its map with it, unless it was deleted meanwhile."""
        noticed = self._noticed(task)
        # Held by nobody here, so that its points can go before all of it is described.
        description = self._recogniser.describe(self._upright(task), config)
        stored = self._store(task, replace(description, flags=(*noticed, *description.flags)))
        failpoint("job.before_enter")
        self._context.write_naming(Entry(lease, task.map, stored), stored.put)
        failpoint("job.after_enter")
        return stored.description

    def _upright(self, task: DescriptionTask) -> Submap:
        return load_submap(self._context.blobs, task.submap, task.source).levelled(in_place=True)

    def _noticed(self, task: DescriptionTask) -> tuple[str, ...]:
        """Likely mistakes in the scans of a submap. They are read once more after that: few are looked at."""
        if not _is_inspected(task.submap):
            return ()
        return self._recogniser.inspect(list(each_scan(self._context.blobs, task.submap, task.source)))

    def _store(self, task: DescriptionTask, description: SubmapDescription) -> StoredDescription:
        """Make the blobs of a description durable before any row names them."""
        submap = task.submap
        blobs = [(PLACE_BLOB, description.place)]
        if description.neural_map is not None:
            blobs.append((NEURAL_MAP_BLOB, description.neural_map))
        failpoint("job.after_description")
        put = partial(self._put, submap.tenant, blobs)
        sha256 = put()
        failpoint("job.after_blobs")
        row = replace(
            submap,
            state=SubmapState.DESCRIBED.value,
            searched=False,
            flags=tuple(dict.fromkeys((*submap.flags, *description.flags))),
            model_version=model_for_map(task.map, self._recogniser),
            descriptor=np.asarray(description.descriptor, dtype="<f4").tobytes(),
            place_sha256=sha256[PLACE_BLOB],
            neural_map_sha256=sha256.get(NEURAL_MAP_BLOB),
            neural_map_bytes=None if description.neural_map is None else len(description.neural_map),
            described_at_ns=self._context.clock.wall_ns(),
            radio=task.radio,
        )
        return StoredDescription(row, description, tuple(sha256.items()), put)

    def _put(self, tenant: TenantId, blobs: list[tuple[str, bytes]]) -> dict[str, str]:
        """Store blobs durably; the hash of each by its kind."""
        return {kind: self._context.blobs.put(tenant, kind, data) for kind, data in blobs}

    def _close_loops(self, lease: Lease, query: Query, config: PipelineConfig) -> None:
        """Search among the submaps that entered before this one, verify and commit."""
        submap, context = query.submap, self._context
        where = partial(_loop_filter, submap=submap, config=config)
        vector = np.frombuffer(require_descriptor(submap), dtype="<f4")
        recalled = self._memory.recall(query.map, vector, config.loop.candidates, where, submap.entered).places
        kept, revised = self._judged(query, recalled, config)
        commit = LoopCommit(context.policy, lease, query, kept, revised, context.clock.wall_ns())
        failpoint("job.before_commit")
        if context.transactions.write(commit).result():
            self._early.update(query.map.tenant, query.map.map_id)

    def _judged(
        self, query: Query, recalled: Sequence[RecalledPlace], config: PipelineConfig
    ) -> tuple[list[JudgedPlace], list[RevisedLoop]]:
        """The recalled places with their claims; and the earlier loops of the drive with claims that change.

        A place with a pose that enough accepted pairs predict is left out (docs/decisions/0161): by odometry, and by
        the version of the map that was in force when the query entered.
        """
        submaps = [one.submap for one in recalled]
        in_map = partial(stations_in_map, self._context.transactions, submaps, query.map)
        predicted = PredictedPoses([station(one) for one in submaps], config, in_map)

        def verify(row: int, initial: InitialPose | None) -> PairVerdict:
            return self._comparison.verify(query.asked, recalled[row], config, initial)

        verdicts = verify_in_turn(predicted, len(recalled), verify)
        places = [recalled[row] for row in verdicts]
        new = [
            LoopClaim(station(query.submap), station(one.submap), verdict)
            for one, verdict in zip(places, verdicts.values(), strict=True)
        ]
        decided, records = self._accept(query, places, new, config)
        kept = [JudgedPlace(one, claim) for one, claim in zip(places, decided.new, strict=True)]
        return kept, [RevisedLoop(records[row], claim) for row, claim in decided.revised.items()]

    def _accept(
        self, query: Query, places: list[RecalledPlace], new: list[LoopClaim], config: PipelineConfig
    ) -> tuple[Decided, list[LoopRecord]]:
        """The claims of a query on `places` judged with its drive before it; and the rows of the earlier claims."""
        if not any(claim.hypotheses for claim in new):
            return Decided(new, {}), []  # then the drive before it need not be read
        submap, before = query.submap, drive_in_turn(self._context, query.submap, config)
        pairs = [
            *(
                (asked, RecalledPlace(match, loop.similarity))
                for loop, (asked, match) in zip(before.loops, before.pairs, strict=True)
            ),
            *((submap, one) for one in places),
        ]

        def verify_near(row: int, near: InitialPose) -> PairVerdict:
            asked, match = pairs[row]
            return self._comparison.verify(query.asked if asked is submap else asked, match, config, near)

        return accept(new, before.drive, config, verify_near), before.loops


def _task(uow: UnitOfWork, policy: Policy, job: JobRecord) -> DescriptionTask | None:
    """The work of a job; None where its submap was deleted (and maybe posted again, with a job of its own)."""
    submap = _submap_of(uow, job)
    if submap is None:
        return None
    of_map, radio = require_map(uow, job.tenant, submap.map_id), fingerprint_of(uow, submap)
    return DescriptionTask(submap, submap_source(uow, policy, submap), of_map, radio)


def _entered(uow: UnitOfWork, _: Policy, job: JobRecord, described: SubmapDescription | None) -> Query | None:
    """The submap of a job as it has entered its map; None where it was deleted. `described`: in this run."""
    submap = _submap_of(uow, job)
    if submap is None:
        return None
    as_of = replace(require_map(uow, job.tenant, submap.map_id), map_version=submap.map_version)
    return Query(submap, as_of) if described is None else Query(submap, as_of, described.place, described.timings_s)


def _submap_of(uow: UnitOfWork, job: JobRecord) -> SubmapRecord | None:
    key = SubmapKey(**job.payload)
    submap = uow.submaps.get(job.tenant, key.map_id, key.session_id, key.submap_id)
    return submap if submap is not None and submap.operation_id == job.operation_id else None


def _loop_filter(uow: UnitOfWork, submap: SubmapRecord, config: PipelineConfig) -> VectorFilter:
    """Any submap of the map but itself, those of its drive that it has just left, and those on other storeys."""
    storey = storey_of(uow, submap.tenant, submap.map_id, submap.session_id)
    policy = candidates_of(uow, submap, config.loop)
    return VectorFilter(
        only_sessions=comparable_sessions(uow, submap.tenant, submap.map_id, storey),
        of_session=policy.session,
        without=policy.too_near,
    )


def _is_inspected(submap: SubmapRecord) -> bool:
    """Whether the scans of a submap are looked at for mistakes. A posted cloud has no others to be compared with."""
    of_scans = submap.first_seq is not None
    return of_scans and (submap.ordinal < INSPECTED_FIRST or submap.ordinal % INSPECTED_EVERY == 0)
