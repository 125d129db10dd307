"""Meshes of submaps: made of the neural map by a worker whenever one is asked for, and not kept."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import Any

from revisit.service.capacity.limits import MESH_POINTS
from revisit.service.domain import limits
from revisit.service.domain.identity import SubmapKey, TenantId
from revisit.service.domain.states import OperationKind
from revisit.service.features.catalogue.downloads import Room
from revisit.service.features.catalogue.job import MESH_NONCE_BYTES
from revisit.service.features.operations.worker_answers import WorkerAnswers
from revisit.service.features.resources.call_context import CallContext
from revisit.service.ports.blobs import MESH_BLOB, StoredBlob
from revisit.service.ports.storage import discard


class SubmapMeshes:
    """`Meshes` by the workers."""

    def __init__(self, context: CallContext, answers: WorkerAnswers) -> None:
        """`answers` asks a worker."""
        self._context = context
        self._answers = answers

    async def file(self, tenant: TenantId, key: SubmapKey, extension: str, room: Room) -> bytes:
        """See `Meshes`. Raises also RateLimited, WorkersBusy, StorageFull, Draining."""
        self._context.admission.require_storage()
        self._context.admission.charge_call(tenant, MESH_POINTS)

        def drop(result: dict[str, Any]) -> None:
            discard(self._context.storage.blobs, StoredBlob(tenant, MESH_BLOB, result["sha256"]))

        payload = {**asdict(key), "format": extension}
        made = await self._answers.answer(tenant, OperationKind.MAKE_MESH, key.name, payload, limits.TILE_WAIT_S, drop)
        try:
            await room(int(made["bytes"]))
            blob = await asyncio.to_thread(self._context.storage.blobs.get, tenant, MESH_BLOB, made["sha256"])
        finally:
            await asyncio.shield(asyncio.to_thread(drop, made))
        return blob[MESH_NONCE_BYTES:]
