"""The jobs that answer queries by cloud: search and localisation."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from revisit.core.acceptance import LoopClaim, Station, accept_cloud, best_loop
from revisit.core.config import PipelineConfig
from revisit.core.geometry.se3 import pose_matrix
from revisit.core.geometry.upright import levelling
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.service.domain.errors import NoAnswer
from revisit.service.domain.records import JobRecord, MapRecord
from revisit.service.features.graph.map_frames import MapPose, submap_in_map
from revisit.service.features.index.answers import (
    Localization,
    LocalizedCandidate,
    criteria_from_json,
    localization_to_json,
    search_result_to_json,
)
from revisit.service.features.index.comparison import Comparison, require_same_model
from revisit.service.features.index.place_memory import PlaceMemory, vector_filter
from revisit.service.features.ingest.clouds import QUERY_NONCE_BYTES, unpack_cloud
from revisit.service.features.loops.claims import evidence_of, station
from revisit.service.features.recognition.rows import JudgedPlace
from revisit.service.features.recognition.stations import stations_in_map
from revisit.service.ports.blobs import QUERY_CLOUD_BLOB
from revisit.service.ports.index import VectorFilter
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.recogniser import PlaceRecogniser, SubmapDescription
from revisit.service.ports.storage import require_map
from revisit.service.ports.transactions import UnitOfWork


class CloudQueryJob:
    """Answers queries by cloud; all calls block."""

    def __init__(self, context: JobContext, memory: PlaceMemory, recogniser: PlaceRecogniser) -> None:
        """`memory` searches this worker's own index."""
        self._context = context
        self._memory = memory
        self._recogniser = recogniser
        self._comparison = Comparison(context.blobs, recogniser)

    def search(self, lease: Lease) -> None:
        """The submaps most similar to a cloud. Raises NoAnswer, NotFound, and the errors of the method."""
        map_record, where = self._query(lease)
        description = self._describe_query(lease, map_record)
        criteria = criteria_from_json(lease.job.payload["criteria"])
        result = self._memory.search(map_record, description.descriptor, criteria, where)
        self._context.complete(lease, search_result_to_json(result))

    def localise(self, lease: Lease) -> None:
        """The pose of a cloud in a map, or its candidates. Raises NoAnswer, NotFound, and the errors of the method."""
        map_record, where = self._query(lease)
        description = self._describe_query(lease, map_record)
        config = self._context.policy.for_map(map_record)
        k = criteria_from_json(lease.job.payload["criteria"]).k
        compared = max(k, config.loop.candidates)
        recall = self._memory.recall(map_record, description.descriptor, compared, lambda _: where)
        verdicts = [self._comparison.verify(description.place, one, config) for one in recall.places]
        # A cloud is of no drive and has no odometry: its own frame is all there is.
        query = Station(None, 0, np.eye(4))
        claims = [
            LoopClaim(query, station(one.submap), verdict) for one, verdict in zip(recall.places, verdicts, strict=True)
        ]
        in_map = stations_in_map(self._context.transactions, [one.submap for one in recall.places])
        claims = accept_cloud(claims, in_map, config)
        judged = [JudgedPlace(one, claim) for one, claim in zip(recall.places, claims, strict=True)]
        found = _localization(judged, k, config)
        pose = self._context.transactions.read(partial(_in_map, found=found, judged=judged)).result()
        answer = replace(found, in_map=pose, on_other_storeys=recall.on_other_storeys)
        self._context.complete(lease, localization_to_json(answer))

    def _query(self, lease: Lease) -> tuple[MapRecord, VectorFilter]:
        return self._context.transactions.read(partial(_queried, job=lease.job)).result()

    def _describe_query(self, lease: Lease, map_record: MapRecord) -> SubmapDescription:
        require_same_model(map_record, self._recogniser)
        sha256 = str(lease.job.payload["cloud_sha256"])
        if not self._context.blobs.exists(lease.job.tenant, QUERY_CLOUD_BLOB, sha256):
            raise NoAnswer("nobody waits for this query any more: its cloud is gone")
        blob = self._context.blobs.get(lease.job.tenant, QUERY_CLOUD_BLOB, sha256)
        cloud = unpack_cloud(blob[QUERY_NONCE_BYTES:])
        config = self._context.policy.for_map(map_record)
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
    match = next(item.place.submap for item in judged if item.place.submap.key == best.submap)
    T_map_match = submap_in_map(uow, match)
    return None if T_map_match is None else T_map_match.of_child(best.T_match_query)


def _localization(judged: list[JudgedPlace], k: int, config: PipelineConfig) -> Localization:
    """The best candidate and the `k` most similar ones, itself among them, of all that were judged together."""
    best = best_loop([one.claim for one in judged])
    rows = [row for row in range(len(judged)) if row < k or row == best]
    candidates = {row: _candidate(judged[row], config) for row in rows}
    if best is None:
        return Localization(None, None, tuple(candidates.values()))
    T_match_query = candidates[best].T_match_query
    T_odom_match = pose_matrix(judged[best].place.submap.T_odom_submap)
    T_odom_query = None if T_match_query is None else T_odom_match @ T_match_query
    return Localization(candidates[best], T_odom_query, tuple(candidates.values()))


def _candidate(judged: JudgedPlace, config: PipelineConfig) -> LocalizedCandidate:
    claim = judged.claim
    return LocalizedCandidate(
        submap=judged.place.submap.key,
        accepted=claim.accepted,
        reason=None if claim.reason is None else claim.reason.value,
        similarity=judged.place.similarity,
        score=claim.score,
        T_match_query=claim.T_match_query,
        evidence=evidence_of(claim, config.verification),
    )
