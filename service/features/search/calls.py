"""Searches: which submaps look like this one, and where in the map a cloud was taken."""

from __future__ import annotations

import asyncio
import math
import secrets
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField, DescriptorModelMismatch
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4, pose_row
from revisit.service.domain import limits
from revisit.service.domain.identity import SubmapKey, TenantId
from revisit.service.domain.states import OperationKind
from revisit.service.features.index.answers import (
    Localization,
    SearchCriteria,
    SearchResult,
    criteria_from_json,
    criteria_to_json,
    localization_from_json,
    search_result_from_json,
    validated_criteria,
)
from revisit.service.features.index.place_memory import PlaceMemory, Question, vector_filter
from revisit.service.features.ingest.clouds import (
    QUERY_NONCE_BYTES,
    CloudDecoder,
    CloudInput,
    accept_cloud,
    pack_cloud,
    reading_points,
)
from revisit.service.features.operations.worker_answers import WorkerAnswers
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.waiting.freshness import Freshness, ReadYourWrites
from revisit.service.ports.blobs import QUERY_CLOUD_BLOB, StoredBlob
from revisit.service.ports.storage import discard, require_descriptor, require_map, require_submap
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class LocalizeQuery:
    """Where was this cloud taken? The prior (metres, in the frame of `only_session`) and the sessions narrow it down.

    The rotation of `T_level_query` (4, 4) turns the cloud upright; without it the cloud's own surfaces do. Submaps that
    are known to be on another `storey` are not compared.
    """

    map_id: str
    cloud: CloudInput
    prior_position_m: tuple[float, float, float] | None = None
    radius_m: float | None = None
    candidates: int = 10
    exclude_session: str | None = None
    only_session: str | None = None
    T_level_query: Matrix4 | None = None
    storey: str | None = None


class Searches:
    """Search by submap, by descriptor or by cloud; localise."""

    def __init__(
        self,
        context: CallContext,
        decoder: CloudDecoder,
        memory: PlaceMemory,
        answers: WorkerAnswers,
        writes: ReadYourWrites,
    ) -> None:
        """Clouds are described by workers, which `answers` asks."""
        self._context = context
        self._decoder = decoder
        self._memory = memory
        self._answers = answers
        self._writes = writes

    async def by_submap(
        self, tenant: TenantId, key: SubmapKey, criteria: SearchCriteria, fresh: Freshness = Freshness()
    ) -> SearchResult:
        """The submaps most like a described one, which is never its own hit.

        Raises NotFound, NotReady, BadField, SeqNotReached where `fresh` was not reached.
        """
        validated_criteria(criteria)
        if criteria.storey is not None:
            raise BadField("a submap is on the storey of its session", field="storey")
        await self._writes.reached(tenant, key.map_id, fresh)
        question = partial(_asked_by, tenant=tenant, key=key, criteria=criteria)
        return await asyncio.to_thread(self._memory.answer, question, criteria)

    async def by_descriptor(
        self,
        tenant: TenantId,
        map_id: str,
        vector: NDArray[np.float32],
        model_version: str,
        criteria: SearchCriteria,
        fresh: Freshness = Freshness(),
    ) -> SearchResult:
        """The submaps nearest to a descriptor (d,), once normalised. Raises as `by_submap`, DescriptorModelMismatch."""
        validated_criteria(criteria)
        unit = _unit(vector)
        await self._writes.reached(tenant, map_id, fresh)
        question = partial(
            _asked_for, tenant=tenant, map_id=map_id, vector=unit, model_version=model_version, criteria=criteria
        )
        return await asyncio.to_thread(self._memory.answer, question, criteria)

    async def by_cloud(
        self,
        tenant: TenantId,
        map_id: str,
        cloud: CloudInput,
        criteria: SearchCriteria,
        fresh: Freshness = Freshness(),
        timeout_s: float = 30.0,
        T_level_query: Matrix4 | None = None,
    ) -> SearchResult:
        """Describe a cloud, turned upright by `T_level_query` (4, 4), in a worker, store no submap, search.

        Raises NoAnswer, WorkersBusy, NotFound, SeqNotReached, ...
        """
        payload = _payload(map_id, validated_criteria(criteria), T_level_query)
        await self._writes.reached(tenant, map_id, fresh)
        answer = await self._ask(tenant, OperationKind.SEARCH_CLOUD, payload, cloud, timeout_s)
        return search_result_from_json(answer)

    async def localize(
        self, tenant: TenantId, query: LocalizeQuery, fresh: Freshness = Freshness(), timeout_s: float = 30.0
    ) -> Localization:
        """Describe a cloud in a worker, search, verify. No match is a result. Raises as `by_cloud`."""
        limits.LOCALIZE_CANDIDATES.validated(query.candidates, "candidates")
        narrowed = SearchCriteria(
            k=query.candidates,
            exclude_session=query.exclude_session,
            only_session=query.only_session,
            prior_position_m=query.prior_position_m,
            radius_m=query.radius_m,
            storey=query.storey,
        )
        criteria = validated_criteria(narrowed)
        payload = _payload(query.map_id, criteria, query.T_level_query)
        await self._writes.reached(tenant, query.map_id, fresh)
        answer = await self._ask(tenant, OperationKind.LOCALIZE, payload, query.cloud, timeout_s)
        return localization_from_json(answer)

    async def _ask(
        self, tenant: TenantId, kind: OperationKind, payload: dict[str, Any], cloud: CloudInput, timeout_s: float
    ) -> dict[str, Any]:
        """Queue the cloud for a worker and wait for the answer. Raises the worker's error, NoAnswer.

        A query that nobody waits for any more is dropped: its job goes with its cloud.
        """
        self._context.admission.require_storage()
        await self._context.storage.read(partial(_require_searchable, tenant=tenant, payload=payload))
        async with self._context.admission.cloud(tenant, refused_points=reading_points(cloud)) as decoded:
            packed, points = await self._decoder.run(tenant, _accept, cloud)
            decoded(points)
            sha256 = await self._context.storage.put_blob(tenant, QUERY_CLOUD_BLOB, packed)
        try:
            content = {**payload, "cloud_sha256": sha256}
            return await self._answers.answer(tenant, kind, f"maps/{payload['map_id']}", content, timeout_s)
        finally:
            blob = StoredBlob(tenant, QUERY_CLOUD_BLOB, sha256)
            await asyncio.shield(asyncio.to_thread(discard, self._context.storage.blobs, blob))


def _require_searchable(uow: UnitOfWork, tenant: TenantId, payload: dict[str, Any]) -> None:
    """Raises NotFound, BadField early: the worker would raise them only after it has described the cloud."""
    require_map(uow, tenant, payload["map_id"])
    vector_filter(uow, tenant, payload["map_id"], criteria_from_json(payload["criteria"]), None)


def _payload(map_id: str, criteria: SearchCriteria, T_level_query: Matrix4 | None) -> dict[str, Any]:
    """The job of a query by cloud. Raises BadTransform."""
    level = {} if T_level_query is None else {"T_level_query": pose_row(se3.validated(T_level_query))}
    return {"map_id": map_id, "criteria": criteria_to_json(criteria), **level}


def _asked_by(uow: UnitOfWork, tenant: TenantId, key: SubmapKey, criteria: SearchCriteria) -> Question:
    """The query of a described submap. Raises NotFound, NotReady, DataLoss, BadField."""
    record = require_submap(uow, tenant, key)
    vector = np.frombuffer(require_descriptor(record), dtype="<f4")
    where = vector_filter(uow, tenant, key.map_id, criteria, record)
    return Question(require_map(uow, tenant, key.map_id), vector, where)


def _asked_for(
    uow: UnitOfWork,
    tenant: TenantId,
    map_id: str,
    vector: NDArray[np.float32],
    model_version: str,
    criteria: SearchCriteria,
) -> Question:
    """The query of a descriptor (d,) of a model. Raises NotFound, BadField, DescriptorModelMismatch."""
    map_record = require_map(uow, tenant, map_id)
    where = vector_filter(uow, tenant, map_id, criteria, None)
    if map_record.model_version not in (None, model_version):
        raise DescriptorModelMismatch(f"map {map_id} was described by model {map_record.model_version}")
    return Question(map_record, vector, where)


def _accept(cloud: CloudInput) -> tuple[bytes, int]:
    """The packed cloud behind a nonce, and how many points it has.

    With a nonce the same cloud asked twice is two blobs, each deleted with its own answer.
    """
    accepted, _ = accept_cloud(cloud, limits.SUBMAP_POINTS)
    return secrets.token_bytes(QUERY_NONCE_BYTES) + pack_cloud(accepted), len(accepted.points)


def _unit(vector: NDArray[np.float32]) -> NDArray[np.float32]:
    """`vector` with norm 1. Raises BadField where it has none."""
    norm = float(np.linalg.norm(vector.astype(np.float64)))
    if not (math.isfinite(norm) and norm > 0.0):
        raise BadField("a descriptor must be finite and not zero", field="descriptor")
    return (vector / norm).astype(np.float32)
