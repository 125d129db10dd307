"""Map files: publish a version as one, look at them, say which robots are to use, download them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from revisit.core.codec.map_layout import MapLayout
from revisit.core.errors import BadField
from revisit.service.capacity.backlog import same_job
from revisit.service.domain import limits
from revisit.service.domain.errors import NotFound
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import MapFileRecord
from revisit.service.domain.states import MapFileState, OperationKind
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.features.deletion.blob_references import forget_file
from revisit.service.features.optimisation.calls import version_seen
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, as_it_is, rows_of_map
from revisit.service.features.resources.views import PostedOperation
from revisit.service.ports.blobs import MAP_LAYOUT_BLOB, NEURAL_MAP_BLOB
from revisit.service.ports.storage import Storage, require_map
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class OpenMapFile:
    """A map file to be sent."""

    record: MapFileRecord
    layout: MapLayout
    storage: Storage
    tenant: TenantId

    async def pieces(self, start: int, end: int) -> AsyncIterator[bytes]:
        """The bytes from `start` to before `end`, read beside the event loop. Raises DataLoss."""
        read = partial(self.storage.blobs.get, self.tenant, NEURAL_MAP_BLOB)
        left = self.layout.pieces(read, start, end)
        while (piece := await asyncio.to_thread(_next, left)) is not None:
            yield piece


class MapFiles:
    """Publish, get, list, enable, delete, open."""

    def __init__(self, context: CallContext) -> None:
        """Files are made by jobs."""
        self._context = context

    async def publish(self, tenant: TenantId, map_id: str, version: int, description: str = "") -> PostedOperation:
        """Queue the making of a file. Raises NotFound, BadField, WorkersBusy, Draining, StorageFull."""
        self._context.admission.require_running()
        self._context.admission.require_storage()
        limits.MAP_VERSION.validated(version, "version")
        if len(description) > limits.NOTE_CHARACTERS or not description.isprintable():
            raise BadField(
                f"map_descriptor is one line of at most {limits.NOTE_CHARACTERS} characters", field="map_descriptor"
            )
        payload = {"map_id": map_id, "version": version, "description": description}
        entry = audit.noted(tenant, "map_published", f"maps/{map_id}/versions/{version}")
        return await self._context.storage.write(partial(self._post, tenant=tenant, payload=payload, entry=entry))

    async def get(self, tenant: TenantId, map_id: str, version: int) -> MapFileRecord:
        """Raises NotFound."""
        read = partial(_require_file, tenant=tenant, map_id=map_id, version=version)
        return await self._context.storage.read(read)

    async def list(self, tenant: TenantId, map_id: str, page: PageRequest) -> Page[MapFileRecord]:
        """The files of a map, oldest first. Raises NotFound."""
        find = rows_of_map(lambda uow: uow.map_files, tenant, map_id)
        return await self._context.lists.page(tenant, page, find, as_it_is)

    async def enable(self, tenant: TenantId, map_id: str, version: int) -> MapFileRecord:
        """Say that robots are to use this file, and no other of the map. Raises NotFound, Draining."""
        self._context.admission.require_running()
        entry = audit.noted(tenant, "map_enabled", f"maps/{map_id}/files/{version}")
        work = partial(self._enable, map_id=map_id, version=version, entry=entry)
        return await self._context.storage.write(work)

    async def delete(self, tenant: TenantId, map_id: str, version: int) -> None:
        """Delete a file; the version stays. Raises NotFound, Draining."""
        self._context.admission.require_running()
        entry = audit.noted(tenant, "map_file_deleted", f"maps/{map_id}/files/{version}")
        await self._context.storage.write(partial(self._delete, map_id=map_id, version=version, entry=entry))

    async def open(self, tenant: TenantId, map_id: str, version: int) -> OpenMapFile:
        """A file to be sent. Raises NotFound, DataLoss."""
        read = partial(_require_file, tenant=tenant, map_id=map_id, version=version)
        record = await self._context.storage.read(read)
        layout = await asyncio.to_thread(self._layout, tenant, record.layout_sha256)
        return OpenMapFile(record, layout, self._context.storage, tenant)

    def _layout(self, tenant: TenantId, sha256: str) -> MapLayout:
        return MapLayout.from_blob(self._context.storage.blobs.get(tenant, MAP_LAYOUT_BLOB, sha256))

    def _post(self, uow: UnitOfWork, tenant: TenantId, payload: dict[str, Any], entry: AuditEntry) -> PostedOperation:
        require_map(uow, tenant, payload["map_id"], hold=True)
        version_seen(uow, tenant, payload["map_id"], payload["version"])
        subject = f"maps/{payload['map_id']}"
        waiting = same_job(uow, tenant, OperationKind.PUBLISH_MAP, subject, payload)
        if waiting is not None:
            return PostedOperation(waiting, replay=True)
        audit.append(uow, self._context.clock.wall_ns(), entry)
        posted = self._context.jobs.post(uow, tenant, OperationKind.PUBLISH_MAP, subject, payload)
        return PostedOperation(posted, replay=False)

    def _enable(self, uow: UnitOfWork, map_id: str, version: int, entry: AuditEntry) -> MapFileRecord:
        tenant = TenantId(entry.tenant)
        require_map(uow, tenant, map_id, hold=True)
        wanted = _require_file(uow, tenant, map_id, version)
        if wanted.state == MapFileState.ENABLED:
            return wanted
        audit.append(uow, self._context.clock.wall_ns(), entry)
        for row in uow.map_files.find(tenant, map_id=map_id, state=MapFileState.ENABLED.value):
            uow.map_files.replace(replace(row, state=MapFileState.DISABLED.value))
        enabled = replace(wanted, state=MapFileState.ENABLED.value)
        uow.map_files.replace(enabled)
        return enabled

    def _delete(self, uow: UnitOfWork, map_id: str, version: int, entry: AuditEntry) -> None:
        tenant = TenantId(entry.tenant)
        record = _require_file(uow, tenant, map_id, version)
        audit.append(uow, self._context.clock.wall_ns(), entry)
        forget_file(uow, record)


def _require_file(uow: UnitOfWork, tenant: TenantId, map_id: str, version: int) -> MapFileRecord:
    require_map(uow, tenant, map_id)
    known = uow.map_files.get(tenant, map_id, version)
    if known is None:
        raise NotFound(f"version {version} of map {map_id!r} is no file: publish it"[:200])
    return known


def _next(pieces: Iterator[bytes]) -> bytes | None:
    return next(pieces, None)
