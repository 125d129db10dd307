"""Conversations of robots that move: each view is described and compared by a worker, and answered at once.

The gateway keeps a conversation as long as its stream: the last scans, and what the views before have told. Nothing of
it is stored.
"""

from __future__ import annotations

import asyncio
import secrets
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import Any

from revisit.core.config import PipelineConfig
from revisit.core.errors import RevisitError
from revisit.core.geometry.se3 import Matrix4
from revisit.core.relocalisation import ConversationState, Relocalisation
from revisit.core.relocalisation.view_window import ViewCloud, ViewWindow
from revisit.service.capacity.in_flight import InFlight
from revisit.service.domain import limits
from revisit.service.domain.identity import TenantId
from revisit.service.domain.states import OperationKind
from revisit.service.features.index.answers import SearchCriteria, criteria_to_json, validated_criteria
from revisit.service.features.index.place_memory import vector_filter
from revisit.service.features.ingest.clouds import (
    QUERY_NONCE_BYTES,
    CloudDecoder,
    CloudInput,
    StoredCloud,
    accept_cloud,
    pack_cloud,
    reading_points,
)
from revisit.service.features.operations.worker_answers import WorkerAnswers
from revisit.service.features.relocalisation.rules import ViewAnswer, answer_from_json, state_to_json, view_to_json
from revisit.service.features.resources.call_context import CallContext
from revisit.service.ports.blobs import QUERY_CLOUD_BLOB, StoredBlob
from revisit.service.ports.storage import discard, require_map
from revisit.service.ports.transactions import UnitOfWork

VIEW_TIMEOUT_S = 30.0
"""How long a view waits for a worker."""


@dataclass(frozen=True)
class StartConversation:
    """Where in this map does a robot drive? The sessions and the storey narrow it down, as in a localisation."""

    map_id: str
    only_session: str | None = None
    exclude_session: str | None = None
    storey: str | None = None


@dataclass(frozen=True)
class _Joined:
    """A view as a worker gets it: the packed points, and the rest of it."""

    packed: bytes
    view: ViewCloud


class Conversations:
    """Begins conversations."""

    def __init__(
        self, context: CallContext, decoder: CloudDecoder, answers: WorkerAnswers, in_flight: InFlight
    ) -> None:
        """Views are compared by workers, which `answers` asks; `in_flight` counts open streams."""
        self._context = context
        self._decoder = decoder
        self._answers = answers
        self._in_flight = in_flight

    def reserve_stream(self, tenant: TenantId) -> AbstractContextManager[None]:
        """The slot of one more conversation, which is a stream (see `InFlight.reserve_stream`). Raises RateLimited."""
        return self._in_flight.reserve_stream(tenant, replaces=False)

    async def begin(self, tenant: TenantId, asked: StartConversation) -> Conversation:
        """Raises NotFound, BadField, Draining."""
        self._context.admission.require_running()
        criteria = validated_criteria(
            SearchCriteria(only_session=asked.only_session, exclude_session=asked.exclude_session, storey=asked.storey)
        )
        read = partial(_config_of, tenant=tenant, map_id=asked.map_id, criteria=criteria, context=self._context)
        config = await self._context.storage.read(read)
        payload = {"map_id": asked.map_id, "criteria": criteria_to_json(criteria)}
        return Conversation(tenant, payload, config, self._context, self._decoder, self._answers)


class Conversation:
    """A conversation: one view after the other."""

    def __init__(
        self,
        tenant: TenantId,
        payload: dict[str, Any],
        config: PipelineConfig,
        context: CallContext,
        decoder: CloudDecoder,
        answers: WorkerAnswers,
    ) -> None:
        self._tenant = tenant
        self._payload = payload
        self._config = config
        self._context = context
        self._decoder = decoder
        self._answers = answers
        self._window = ViewWindow(config.submap)
        self._state = state_to_json(ConversationState())

    async def see(self, cloud: CloudInput, T_odom_sensor: Matrix4) -> ViewAnswer:
        """The answer to one more scan. One without enough returns is answered, too.

        Raises the errors of decoding and validation, the worker's error, NoAnswer, WorkersBusy, RateLimited, Draining,
        StorageFull.
        """
        admission = self._context.admission
        admission.require_storage()
        async with admission.cloud(self._tenant, refused_points=reading_points(cloud), patient=True) as decoded:
            accepted, _ = await self._decoder.run(self._tenant, accept_cloud, cloud, limits.SCAN_POINTS)
            decoded(len(accepted.points))
            try:
                joined = await self._decoder.run(self._tenant, self._join, accepted, T_odom_sensor)
            except RevisitError:
                return ViewAnswer(Relocalisation(self._config).lost(self._window.travelled_m), ())
            sha256 = await self._context.storage.put_blob(self._tenant, QUERY_CLOUD_BLOB, joined.packed)
        return await self._asked(joined.view, sha256)

    def _join(self, accepted: StoredCloud, T_odom_sensor: Matrix4) -> _Joined:
        view = self._window.add(accepted.points, T_odom_sensor)
        packed = secrets.token_bytes(QUERY_NONCE_BYTES) + pack_cloud(StoredCloud(view.points))
        return _Joined(packed, view)

    async def _asked(self, view: ViewCloud, sha256: str) -> ViewAnswer:
        content = {
            **self._payload,
            **view_to_json(view, self._window.travelled_m),
            "cloud_sha256": sha256,
            "state": self._state,
        }
        subject = f"maps/{self._payload['map_id']}"
        try:
            found = await self._answers.answer(self._tenant, OperationKind.RELOCALISE, subject, content, VIEW_TIMEOUT_S)
        finally:
            blob = StoredBlob(self._tenant, QUERY_CLOUD_BLOB, sha256)
            await asyncio.shield(asyncio.to_thread(discard, self._context.storage.blobs, blob))
        self._state = found["state"]
        return answer_from_json(found["answer"])


def _config_of(
    uow: UnitOfWork, tenant: TenantId, map_id: str, criteria: SearchCriteria, context: CallContext
) -> PipelineConfig:
    """The parameters of a map that can be searched so. Raises NotFound, BadField."""
    record = require_map(uow, tenant, map_id)
    vector_filter(uow, tenant, map_id, criteria, None)
    return context.policy.for_map(record)
