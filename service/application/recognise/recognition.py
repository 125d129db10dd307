"""Recognition: what a worker does with a job. Describe a submap and close its loops; search by cloud; localise.

A described submap, its loop closures, its place in the index and the end of its job are one transaction, which also
checks the fencing token and that no submap entered the index since the search: so a loop between two submaps that two
workers describe at the same time is found by the one that commits second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import structlog

from revisit.core.acceptance import (
    Decided,
    LoopClaim,
    PredictedPoses,
    Station,
    StationInMap,
    accept,
    accept_cloud,
    verify_in_turn,
)
from revisit.core.config import PipelineConfig
from revisit.core.errors import DataLoss, DescriptorModelMismatch, ErrorCode, RevisitError
from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.core.pair_verdict import PairVerdict, RejectedLoop, RejectionReason, VerifiedLoop
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.core.upright import levelling
from revisit.service.application.catalogue.deletion import SUBMAP_DELETED
from revisit.service.application.catalogue.maps import model_for_map
from revisit.service.application.catalogue.mesh_making import MeshMaking
from revisit.service.application.contract.blobs import NEURAL_MAP_BLOB, PLACE_BLOB, QUERY_CLOUD_BLOB, BlobStore
from revisit.service.application.contract.clock import Clock
from revisit.service.application.contract.errors import NoAnswer, StaleLease, StorageFull, Unavailable
from revisit.service.application.contract.identity import SubmapKey
from revisit.service.application.contract.index import VectorFilter
from revisit.service.application.contract.job_queue import CANCELLED, Lease
from revisit.service.application.contract.loop_claims import drive_before, evidence_of, station
from revisit.service.application.contract.map_frames import MapFrames, MapPose, submap_in_map
from revisit.service.application.contract.own_drive import candidates_of
from revisit.service.application.contract.policy import Policy
from revisit.service.application.contract.recogniser import PlaceRecogniser, SubmapDescription
from revisit.service.application.contract.records import JobRecord, LoopRecord, MapRecord, SubmapRecord
from revisit.service.application.contract.states import LoopState, OperationKind, SubmapState
from revisit.service.application.contract.storage import require_map
from revisit.service.application.contract.storeys import comparable_sessions, storey_of
from revisit.service.application.contract.tracing import current_request
from revisit.service.application.contract.transactions import Transactions, UnitOfWork
from revisit.service.application.contract.views import submap_key
from revisit.service.application.housekeeping.dead_letters import mark_subject_failed
from revisit.service.application.ingest.clouds import QUERY_NONCE_BYTES, unpack_cloud
from revisit.service.application.ingest.submap_source import each_scan, load_submap, submap_source
from revisit.service.application.mapping.early_corrections import EarlyCorrections
from revisit.service.application.mapping.map_filing import MapFiling
from revisit.service.application.mapping.merging import MapMerging
from revisit.service.application.mapping.optimisation import MapOptimisation
from revisit.service.application.mapping.progress import OperationCancelled, Progress
from revisit.service.application.mapping.tile_making import TileMaking
from revisit.service.application.query.place_memory import PlaceMemory, Recall, RecalledPlace, vector_filter
from revisit.service.application.query.search_answers import (
    Localization,
    LocalizedCandidate,
    criteria_from_json,
    localization_to_json,
    search_result_to_json,
)
from revisit.service.application.recognise.description_commit import (
    DescriptionCommit,
    DescriptionTask,
    JudgedPlace,
    RevisedLoop,
    StoredDescription,
)
from revisit.service.application.recognise.proposed_loops import VerdictCommit, proposed_pair
from revisit.service.application.recognise.recalled_loops import (
    RecallCommit,
    RecalledLoop,
    kept_near,
    loops_to_recall,
)
from revisit.service.failpoints import failpoint

log = structlog.get_logger(__name__)

INSPECTED_FIRST = 3
INSPECTED_EVERY = 20
"""Mistakes about units, frames and times run through a session: its first submaps are inspected, then some."""

LARGE_MAP_LOOPS = 2000
"""Accepted loops from which on optimising a map takes so much memory, and so long, that room is made for it."""

LOST = RejectedLoop(RejectionReason.PLACE_LOST)
"""The verdict on a pair of which a place is damaged."""


@dataclass(frozen=True)
class MapWork:
    """The jobs about whole maps: optimise, merge, make and measure tiles, publish; what loops correct before that."""

    mapping: MapOptimisation
    merging: MapMerging
    tiles: TileMaking
    filing: MapFiling
    early: EarlyCorrections


class Recognition:
    """Runs leased jobs in a worker process; all calls block."""

    def __init__(
        self,
        transactions: Transactions,
        blobs: BlobStore,
        memory: PlaceMemory,
        clock: Clock,
        policy: Policy,
        recogniser: PlaceRecogniser,
        maps: MapWork,
    ) -> None:
        """`recogniser` is the method; `memory` searches this worker's own index; `maps` are jobs about whole maps."""
        self._transactions = transactions
        self._blobs = blobs
        self._memory = memory
        self._clock = clock
        self._policy = policy
        self._recogniser = recogniser
        self._maps = maps
        self._meshes = MeshMaking(transactions, blobs, clock, policy, recogniser)

    def run(self, lease: Lease) -> None:
        """Run a job and commit its end, good or bad. Raises only what storage raises while the end is committed."""
        kinds = {
            OperationKind.DESCRIBE_SUBMAP: self._describe_submap,
            OperationKind.SEARCH_CLOUD: self._search_cloud,
            OperationKind.LOCALIZE: self._localize,
            OperationKind.OPTIMISE_MAP: self._optimise_map,
            OperationKind.VERIFY_LOOP: self._verify_loop,
            OperationKind.MERGE_MAP: self._maps.merging.run,
            OperationKind.MAKE_TILE: self._maps.tiles.make,
            OperationKind.MEASURE_MAP: self._maps.tiles.measure,
            OperationKind.PUBLISH_MAP: self._maps.filing.run,
            OperationKind.RECALL_LOOPS: self._recall_loops,
            OperationKind.MAKE_MESH: self._meshes.run,
        }
        try:
            failpoint("job.after_claim")
            kinds[OperationKind(lease.job.kind)](lease)
            failpoint("job.after_commit")
        except StaleLease:
            log.warning("result_refused", operation=lease.job.operation_id, token=lease.job.lease_token)
        except RevisitError as error:
            # A store that is full, or does not answer, says nothing about the job.
            of_storage = isinstance(error, Unavailable | StorageFull)
            self._fail(lease, error.code, error.message, retry=of_storage, innocent=of_storage)
        except MemoryError:
            self.fail(lease, "the job needs more memory than a worker may take")
        except Exception as error:  # whatever the method raises must not end the worker
            log.exception("job_crashed", operation=lease.job.operation_id)
            self.fail(lease, f"{type(error).__name__}: {error}"[:500])

    def fail(self, lease: Lease, message: str) -> None:
        """End this run of a job: back to the queue, or failed for good after its last attempt."""
        self._fail(lease, ErrorCode.INTERNAL, message, retry=True)

    def _fail(self, lease: Lease, code: ErrorCode, message: str, *, retry: bool, innocent: bool = False) -> None:
        end = partial(self._store_failure, lease=lease, code=code, message=message, retry=retry, innocent=innocent)
        failpoint("job.before_failure")
        current_request().span.fail(f"{code}: {message}")
        log.warning("job_failed", operation=lease.job.operation_id, code=code, reason=message, retry=retry)
        try:
            self._transactions.write(end).result()
        except StaleLease:
            log.warning("failure_refused", operation=lease.job.operation_id, token=lease.job.lease_token)

    def _store_failure(
        self, uow: UnitOfWork, lease: Lease, code: ErrorCode, message: str, *, retry: bool, innocent: bool
    ) -> None:
        now, now_ns = self._clock.instant(), self._clock.wall_ns()
        if uow.queue.fail(lease, code, message, now, now_ns, retry=retry, innocent=innocent):
            mark_subject_failed(uow, lease.job, code, message)

    def _complete(self, lease: Lease, result: dict[str, Any]) -> None:
        now, now_ns = self._clock.instant(), self._clock.wall_ns()
        self._transactions.write(lambda uow: uow.queue.complete(lease, result, now, now_ns)).result()

    # -- describing a submap

    def _describe_submap(self, lease: Lease) -> None:
        task = self._transactions.read(partial(self._task, job=lease.job)).result()
        if task is None:
            self._complete(lease, SUBMAP_DELETED)
            return
        self._require_same_model(task.map)
        config = self._policy.for_map(task.map)
        noticed = self._noticed(task)
        # Held by nobody here, so that its points can go before all of it is described.
        description = self._recogniser.describe(self._upright(task), config)
        described = self._store(task, replace(description, flags=(*noticed, *description.flags)))
        self._close_loops(lease, task, described, config)

    def _upright(self, task: DescriptionTask) -> Submap:
        return load_submap(self._blobs, task.submap, task.source).levelled(in_place=True)

    def _noticed(self, task: DescriptionTask) -> tuple[str, ...]:
        """What is noticed about the scans of a submap. They are read once more after that: few are looked at."""
        if not _is_inspected(task.submap):
            return ()
        return self._recogniser.inspect(list(each_scan(self._blobs, task.submap, task.source)))

    def _task(self, uow: UnitOfWork, job: JobRecord) -> DescriptionTask | None:
        key = SubmapKey(**job.payload)
        submap = uow.submaps.get(job.tenant, key.map_id, key.session_id, key.submap_id)
        if submap is None or submap.operation_id != job.operation_id:
            return None
        return DescriptionTask(
            submap, submap_source(uow, self._policy, submap), require_map(uow, job.tenant, key.map_id)
        )

    def _store(self, task: DescriptionTask, description: SubmapDescription) -> StoredDescription:
        """Make the blobs of a description durable before any row names them."""
        submap = task.submap
        blobs = [(PLACE_BLOB, description.place)]
        if description.neural_map is not None:
            blobs.append((NEURAL_MAP_BLOB, description.neural_map))
        failpoint("job.after_description")
        sha256 = {kind: self._blobs.put(submap.tenant, kind, data) for kind, data in blobs}
        failpoint("job.after_blobs")
        row = replace(
            submap,
            state=SubmapState.DESCRIBED.value,
            flags=tuple(dict.fromkeys((*submap.flags, *description.flags))),
            model_version=model_for_map(task.map, self._recogniser.model_version),
            descriptor=np.asarray(description.descriptor, dtype="<f4").tobytes(),
            place_sha256=sha256[PLACE_BLOB],
            neural_map_sha256=sha256.get(NEURAL_MAP_BLOB),
            neural_map_bytes=None if description.neural_map is None else len(description.neural_map),
        )
        return StoredDescription(row, description, tuple(blobs))

    def _close_loops(
        self, lease: Lease, task: DescriptionTask, described: StoredDescription, config: PipelineConfig
    ) -> None:
        """Search, verify and commit; again where the map has grown meanwhile, verifying only what is new.

        Every repetition means that another worker has committed, so together the workers always get on.
        """
        where = partial(_loop_filter, submap=task.submap, config=config)
        judged: dict[int, PairVerdict] = {}
        while True:
            recall = self._memory.recall(task.map, described.description.descriptor, config.loop.candidates, where)
            kept, earlier = self._judged(task.submap, described.description.place, recall, config, judged)
            now, now_ns = self._clock.instant(), self._clock.wall_ns()
            commit = DescriptionCommit(
                self._blobs, self._policy, lease, task, described, kept, earlier, where, recall.seq, now, now_ns
            )
            failpoint("job.before_commit")
            if self._transactions.write(commit).result():
                if earlier or any(one.claim.accepted for one in kept):
                    self._maps.early.take_in(task.map.tenant, task.map.map_id)
                return

    def _judged(
        self,
        submap: SubmapRecord,
        place: bytes,
        recall: Recall,
        config: PipelineConfig,
        judged: dict[int, PairVerdict],
    ) -> tuple[list[JudgedPlace], list[RevisedLoop]]:
        """The recalled places with their claims; and the earlier loops of the drive whose claims change with them.

        `judged`: verdicts by number of submap; those that are there stand, new ones are added. Places whose pose enough
        accepted pairs predict are left out (docs/decisions/0161).
        """
        recalled = [one.submap for one in recall.places]
        predicted = PredictedPoses(
            [station(one) for one in recalled], config, partial(_in_map_now, self._transactions, recalled)
        )
        known = {row: judged[one.number] for row, one in enumerate(recalled) if one.number in judged}

        def verify(row: int, expected: Matrix4 | None) -> PairVerdict:
            return self._verify(place, recall.places[row], config, expected=expected)

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
        before = self._transactions.read(partial(drive_before, submap=submap, config=config)).result()
        pairs = [
            *(
                (query, RecalledPlace(match, loop.similarity))
                for loop, (query, match) in zip(before.loops, before.pairs, strict=True)
            ),
            *((submap, one) for one in places),
        ]

        def verify_near(row: int, near: Matrix4) -> PairVerdict:
            query, match = pairs[row]
            asked = place if query is submap else self._stored_place(query)
            return LOST if asked is None else self._verify(asked, match, config, near)

        return accept(new, before.drive, config, verify_near), before.loops

    def _verify(
        self,
        place: bytes,
        recalled: RecalledPlace,
        config: PipelineConfig,
        near: Matrix4 | None = None,
        near_decides: bool = True,
        expected: Matrix4 | None = None,
    ) -> PairVerdict:
        submap = recalled.submap
        try:
            blob = self._blobs.get(submap.tenant, PLACE_BLOB, str(submap.place_sha256))
            return self._recogniser.verify(
                place, blob, recalled.similarity, config, near, near_decides=near_decides, expected=expected
            )
        except DataLoss as error:
            log.error("place_lost", submap=submap_key(submap).name, reason=error.message)
            return replace(LOST, message=error.message)

    def _stored_place(self, submap: SubmapRecord) -> bytes | None:
        """The blob of a described submap's place; None where it is damaged."""
        try:
            return self._blobs.get(submap.tenant, PLACE_BLOB, str(submap.place_sha256))
        except DataLoss as error:
            log.error("place_lost", submap=submap_key(submap).name, reason=error.message)
            return None

    def _require_same_model(self, record: MapRecord) -> None:
        own = model_for_map(record, self._recogniser.model_version)
        if record.model_version not in (None, own):
            raise DescriptorModelMismatch(
                f"map {record.map_id} was described by model {record.model_version}, this worker has {own}"
            )

    def _optimise_map(self, lease: Lease) -> None:
        """Optimise a map; the loops that came in meanwhile correct the version that is in force now."""
        tenant, map_id = lease.job.tenant, str(lease.job.payload["map_id"])
        self._maps.early.let_go(tenant, map_id)
        accepted = {"map_id": map_id, "state": LoopState.ACCEPTED.value}
        if self._transactions.read(lambda uow: uow.loops.count(tenant, **accepted)).result() >= LARGE_MAP_LOOPS:
            self._recogniser.let_go()
        self._maps.mapping.run(lease)
        self._maps.early.take_in(tenant, map_id)

    def _verify_loop(self, lease: Lease) -> None:
        """Register the two submaps of a loop that a person has made."""
        pair = self._transactions.read(partial(proposed_pair, job=lease.job)).result()
        verdict = None
        if pair is not None:
            place = self._blobs.get(pair.query.tenant, PLACE_BLOB, str(pair.query.place_sha256))
            verdict = self._verify(place, pair.match, self._policy.for_map(pair.map), pair.near)
        now, now_ns = self._clock.instant(), self._clock.wall_ns()
        commit = VerdictCommit(lease, self._recogniser.model_version, self._policy, pair, verdict, now, now_ns)
        self._transactions.write(commit).result()
        if pair is not None and isinstance(verdict, VerifiedLoop):
            self._maps.early.take_in(pair.map.tenant, pair.map.map_id)

    def _recall_loops(self, lease: Lease) -> None:
        """Register rejected loops again from where the new version of their map has their submaps."""
        tenant, map_id = lease.job.tenant, str(lease.job.payload["map_id"])
        progress = Progress(self._transactions, self._clock, lease)
        try:
            loops = loops_to_recall(self._transactions, self._policy, tenant, map_id, progress)
            tested = []
            for done, loop in enumerate(loops):
                progress("VERIFY_LOOPS", done, len(loops))
                tested.append(self._recalled(loop))
        except OperationCancelled:
            self._complete(lease, CANCELLED)
            return
        failpoint("recall.before_commit")
        now, now_ns = self._clock.instant(), self._clock.wall_ns()
        commit = RecallCommit(lease, self._recogniser.model_version, self._policy, tested, now, now_ns)
        if self._transactions.write(commit).result():
            self._maps.early.take_in(tenant, map_id)

    def _recalled(self, loop: RecalledLoop) -> RecalledLoop:
        place = self._stored_place(loop.query)
        if place is None:
            return replace(loop, verdict=LOST)
        config = self._policy.for_map(loop.map)
        match = RecalledPlace(loop.match, loop.record.similarity)
        verdict = self._verify(place, match, config, loop.T_match_query, near_decides=False)
        return kept_near(loop, verdict)

    # -- searching by cloud

    def _search_cloud(self, lease: Lease) -> None:
        map_record, where = self._query(lease)
        description = self._describe_query(lease, map_record)
        criteria = criteria_from_json(lease.job.payload["criteria"])
        result = self._memory.search(map_record, description.descriptor, criteria, where)
        self._complete(lease, search_result_to_json(result))

    def _localize(self, lease: Lease) -> None:
        map_record, where = self._query(lease)
        description = self._describe_query(lease, map_record)
        config = self._policy.for_map(map_record)
        k = criteria_from_json(lease.job.payload["criteria"]).k
        compared = max(k, config.loop.candidates)
        recall = self._memory.recall(map_record, description.descriptor, compared, lambda _: where)
        verdicts = [self._verify(description.place, one, config) for one in recall.places]
        # A cloud is of no drive and has no odometry: its own frame is all there is.
        query = Station(None, 0, np.eye(4))
        claims = [
            LoopClaim(query, station(one.submap), verdict) for one, verdict in zip(recall.places, verdicts, strict=True)
        ]
        claims = accept_cloud(claims, _in_map_now(self._transactions, [one.submap for one in recall.places]), config)
        judged = [JudgedPlace(one, claim) for one, claim in zip(recall.places, claims, strict=True)]
        found = _localization(judged, k, config)
        in_map = self._transactions.read(partial(_in_map, found=found, judged=judged)).result()
        left_out = self._memory.on_other_storeys(map_record, where)
        self._complete(lease, localization_to_json(replace(found, in_map=in_map, on_other_storeys=left_out)))

    def _query(self, lease: Lease) -> tuple[MapRecord, VectorFilter]:
        return self._transactions.read(partial(_queried, job=lease.job)).result()

    def _describe_query(self, lease: Lease, map_record: MapRecord) -> SubmapDescription:
        self._require_same_model(map_record)
        sha256 = str(lease.job.payload["cloud_sha256"])
        if not self._blobs.exists(lease.job.tenant, QUERY_CLOUD_BLOB, sha256):
            raise NoAnswer("nobody waits for this query any more: its cloud is gone")
        blob = self._blobs.get(lease.job.tenant, QUERY_CLOUD_BLOB, sha256)
        cloud = unpack_cloud(blob[QUERY_NONCE_BYTES:])
        config = self._policy.for_map(map_record)
        # Submaps are described upright by their pose; a query has no other.
        level = lease.job.payload.get("T_level_query")
        T_level_query = levelling(cloud.points) if level is None else pose_matrix(tuple(level))
        submap = Submap.from_cloud(Scan.validated(cloud.points, T_level_query, 0), config.submap)
        return self._recogniser.describe(submap, config)


def _queried(uow: UnitOfWork, job: JobRecord) -> tuple[MapRecord, VectorFilter]:
    """The map that a query is about, and which submaps may be hits. Raises NotFound."""
    map_id, criteria = str(job.payload["map_id"]), criteria_from_json(job.payload["criteria"])
    where = vector_filter(uow, job.tenant, map_id, criteria, None)
    return require_map(uow, job.tenant, map_id), where


def _in_map(uow: UnitOfWork, found: Localization, judged: list[JudgedPlace]) -> MapPose | None:
    """Where the cloud lies in the map, if the session of the best candidate does."""
    best = found.best
    if best is None or best.T_match_query is None:
        return None
    match = next(item.place.submap for item in judged if submap_key(item.place.submap) == best.submap)
    T_map_match = submap_in_map(uow, match)
    return None if T_map_match is None else T_map_match.of_child(best.T_match_query)


def _loop_filter(uow: UnitOfWork, submap: SubmapRecord, config: PipelineConfig) -> VectorFilter:
    """Any submap of the map but itself, those of its drive that it has just left, and those on other storeys."""
    storey = storey_of(uow, submap.tenant, submap.map_id, submap.session_id)
    policy = candidates_of(uow, submap, config.loop)
    return VectorFilter(
        only_sessions=comparable_sessions(uow, submap.tenant, submap.map_id, storey),
        of_session=policy.session,
        without=policy.too_near,
    )


def _in_map_now(transactions: Transactions, submaps: Sequence[SubmapRecord]) -> list[StationInMap | None]:
    """Where submaps of one map lie in its version in force; None for those that have no place there."""
    if not submaps:
        return []
    poses = transactions.read(partial(_poses_in_map, submaps=submaps)).result()
    return [None if pose is None else StationInMap(pose.frame, pose_matrix(pose.T_map)) for pose in poses]


def _poses_in_map(uow: UnitOfWork, submaps: Sequence[SubmapRecord]) -> list[MapPose | None]:
    frames = MapFrames(uow, submaps[0].tenant, submaps[0].map_id)
    return [frames.submap(one) for one in submaps]


def _localization(judged: list[JudgedPlace], k: int, config: PipelineConfig) -> Localization:
    """The best candidate and the `k` most similar ones, itself among them, of all that were judged together."""
    accepted = [row for row, one in enumerate(judged) if one.claim.accepted]
    best = max(accepted, key=lambda row: (judged[row].claim.score, -row), default=None)
    told = [row for row in range(len(judged)) if row < k or row == best]
    candidates = {row: _candidate(judged[row], config) for row in told}
    if best is None:
        return Localization(None, None, tuple(candidates.values()))
    T_match_query = candidates[best].T_match_query
    T_odom_match = pose_matrix(judged[best].place.submap.T_odom_submap)
    T_odom_query = None if T_match_query is None else T_odom_match @ T_match_query
    return Localization(candidates[best], T_odom_query, tuple(candidates.values()))


def _candidate(judged: JudgedPlace, config: PipelineConfig) -> LocalizedCandidate:
    claim = judged.claim
    return LocalizedCandidate(
        submap=submap_key(judged.place.submap),
        accepted=claim.accepted,
        reason=None if claim.reason is None else claim.reason.value,
        similarity=judged.place.similarity,
        score=claim.score,
        T_match_query=claim.T_match_query,
        evidence=evidence_of(claim, config.verification),
    )


def _is_inspected(submap: SubmapRecord) -> bool:
    """Whether the scans of a submap are looked at for mistakes. A posted cloud has no others to be compared with."""
    of_scans = submap.first_seq is not None
    return of_scans and (submap.ordinal < INSPECTED_FIRST or submap.ordinal % INSPECTED_EVERY == 0)
