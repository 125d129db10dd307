"""The job that describes a submap and closes its loops.

A described submap, its loop closures, its place in the index and the end of its job are one transaction, which also
checks the fencing token and that no submap entered the index since the search: so a loop between two submaps that two
workers describe at the same time is found by the one that commits second.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from revisit.core.acceptance import Decided, LoopClaim, PredictedPoses, accept, verify_in_turn
from revisit.core.config import PipelineConfig
from revisit.core.pair_verdict import InitialPose, PairVerdict
from revisit.core.submap import Submap
from revisit.service.domain.identity import SubmapKey
from revisit.service.domain.records import JobRecord, LoopRecord, SubmapRecord
from revisit.service.domain.states import SubmapState
from revisit.service.failpoints import failpoint
from revisit.service.features.catalogue.maps import model_for_map
from revisit.service.features.catalogue.storeys import comparable_sessions, storey_of
from revisit.service.features.corrections.job import EarlyCorrections
from revisit.service.features.deletion.rows import SUBMAP_DELETED
from revisit.service.features.index.comparison import Comparison, require_same_model
from revisit.service.features.index.own_drive import candidates_of
from revisit.service.features.index.place_memory import PlaceMemory, Recall, RecalledPlace
from revisit.service.features.ingest.rows import each_scan, load_submap, submap_source
from revisit.service.features.loops.claims import drive_before, station
from revisit.service.features.recognition.rows import (
    DescriptionCommit,
    DescriptionTask,
    JudgedPlace,
    RevisedLoop,
    StoredDescription,
)
from revisit.service.features.recognition.stations import stations_in_map
from revisit.service.ports.blobs import NEURAL_MAP_BLOB, PLACE_BLOB
from revisit.service.ports.index import VectorFilter
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.recogniser import PlaceRecogniser, SubmapDescription
from revisit.service.ports.storage import require_map
from revisit.service.ports.transactions import UnitOfWork

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
        """Describe, search, verify and commit. Raises RevisitError where the submap cannot be described."""
        task = self._context.transactions.read(partial(self._task, job=lease.job)).result()
        if task is None:
            self._context.complete(lease, SUBMAP_DELETED)
            return
        require_same_model(task.map, self._recogniser)
        config = self._context.policy.for_map(task.map)
        noticed = self._noticed(task)
        # Held by nobody here, so that its points can go before all of it is described.
        description = self._recogniser.describe(self._upright(task), config)
        described = self._store(task, replace(description, flags=(*noticed, *description.flags)))
        self._close_loops(lease, task, described, config)

    def _upright(self, task: DescriptionTask) -> Submap:
        return load_submap(self._context.blobs, task.submap, task.source).levelled(in_place=True)

    def _noticed(self, task: DescriptionTask) -> tuple[str, ...]:
        """Likely mistakes in the scans of a submap. They are read once more after that: few are looked at."""
        if not _is_inspected(task.submap):
            return ()
        return self._recogniser.inspect(list(each_scan(self._context.blobs, task.submap, task.source)))

    def _task(self, uow: UnitOfWork, job: JobRecord) -> DescriptionTask | None:
        key = SubmapKey(**job.payload)
        submap = uow.submaps.get(job.tenant, key.map_id, key.session_id, key.submap_id)
        if submap is None or submap.operation_id != job.operation_id:
            return None
        return DescriptionTask(
            submap, submap_source(uow, self._context.policy, submap), require_map(uow, job.tenant, key.map_id)
        )

    def _store(self, task: DescriptionTask, description: SubmapDescription) -> StoredDescription:
        """Make the blobs of a description durable before any row names them."""
        submap = task.submap
        blobs = [(PLACE_BLOB, description.place)]
        if description.neural_map is not None:
            blobs.append((NEURAL_MAP_BLOB, description.neural_map))
        failpoint("job.after_description")
        sha256 = {kind: self._context.blobs.put(submap.tenant, kind, data) for kind, data in blobs}
        failpoint("job.after_blobs")
        row = replace(
            submap,
            state=SubmapState.DESCRIBED.value,
            flags=tuple(dict.fromkeys((*submap.flags, *description.flags))),
            model_version=model_for_map(task.map, self._recogniser),
            descriptor=np.asarray(description.descriptor, dtype="<f4").tobytes(),
            place_sha256=sha256[PLACE_BLOB],
            neural_map_sha256=sha256.get(NEURAL_MAP_BLOB),
            neural_map_bytes=None if description.neural_map is None else len(description.neural_map),
        )
        return StoredDescription(row, description, tuple(blobs))

    def _close_loops(
        self, lease: Lease, task: DescriptionTask, described: StoredDescription, config: PipelineConfig
    ) -> None:
        """Search, verify and commit; again where the map has grown meanwhile, verifying only new candidates.

        Every repetition means that another worker has committed, so together the workers always get on.
        """
        where = partial(_loop_filter, submap=task.submap, config=config)
        judged: dict[int, PairVerdict] = {}
        while True:
            recall = self._memory.recall(task.map, described.description.descriptor, config.loop.candidates, where)
            kept, earlier = self._judged(task.submap, described.description.place, recall, config, judged)
            context = self._context
            now_ns = context.clock.wall_ns()
            commit = DescriptionCommit(
                context.blobs, context.policy, lease, task, described, kept, earlier, where, recall.seq, now_ns
            )
            failpoint("job.before_commit")
            if context.transactions.write(commit).result():
                if earlier or any(one.claim.accepted for one in kept):
                    self._early.update(task.map.tenant, task.map.map_id)
                return

    def _judged(
        self,
        submap: SubmapRecord,
        place: bytes,
        recall: Recall,
        config: PipelineConfig,
        judged: dict[int, PairVerdict],
    ) -> tuple[list[JudgedPlace], list[RevisedLoop]]:
        """The recalled places with their claims; and the earlier loops of the drive with claims that change.

        `judged`: verdicts by number of submap; those that are there stand, new ones are added. A place with a pose that
        enough accepted pairs predict is left out (docs/decisions/0161).
        """
        recalled = [one.submap for one in recall.places]
        predicted = PredictedPoses(
            [station(one) for one in recalled], config, partial(stations_in_map, self._context.transactions, recalled)
        )
        known = {row: judged[one.number] for row, one in enumerate(recalled) if one.number in judged}

        def verify(row: int, initial: InitialPose | None) -> PairVerdict:
            return self._comparison.verify(place, recall.places[row], config, initial)

        verdicts = verify_in_turn(predicted, len(recalled), verify, known)
        judged.update({recalled[row].number: verdict for row, verdict in verdicts.items()})
        places = [recall.places[row] for row in verdicts]
        new = [
            LoopClaim(station(submap), station(one.submap), verdict)
            for one, verdict in zip(places, verdicts.values(), strict=True)
        ]
        decided, records = self._accept(submap, place, places, new, config)
        kept = [JudgedPlace(one, claim) for one, claim in zip(places, decided.new, strict=True)]
        return kept, [RevisedLoop(records[row], claim) for row, claim in decided.revised.items()]

    def _accept(
        self,
        submap: SubmapRecord,
        place: bytes,
        places: list[RecalledPlace],
        new: list[LoopClaim],
        config: PipelineConfig,
    ) -> tuple[Decided, list[LoopRecord]]:
        """The claims of `submap` on `places` judged with its drive before it; and the rows of the earlier claims."""
        if not any(claim.hypotheses for claim in new):
            return Decided(new, {}), []  # then the drive before it need not be read
        before = self._context.transactions.read(partial(drive_before, submap=submap, config=config)).result()
        pairs = [
            *(
                (query, RecalledPlace(match, loop.similarity))
                for loop, (query, match) in zip(before.loops, before.pairs, strict=True)
            ),
            *((submap, one) for one in places),
        ]

        def verify_near(row: int, near: InitialPose) -> PairVerdict:
            query, match = pairs[row]
            return self._comparison.verify(place if query is submap else query, match, config, near)

        return accept(new, before.drive, config, verify_near), before.loops


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
