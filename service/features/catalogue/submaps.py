"""Submaps: get, list, delete and download them."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np

from revisit.service.capacity.charged_work import ChargedWork
from revisit.service.domain.identity import SessionKey, SubmapKey, TenantId
from revisit.service.domain.records import SubmapRecord
from revisit.service.domain.states import SubmapState
from revisit.service.failpoints import failpoint
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.features.catalogue.downloads import (
    RENDERING_BYTES,
    Download,
    DownloadKind,
    Room,
    any_room,
    extension_of,
    named,
    require_neural_map,
    stored_file,
)
from revisit.service.features.deletion.rows import delete_submap
from revisit.service.features.graph.map_frames import MapFrames, submap_in_map
from revisit.service.features.ingest.rows import SubmapSource, submap_source
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, as_it_is
from revisit.service.features.resources.views import SubmapView
from revisit.service.ports.storage import (
    require_descriptor,
    require_map,
    require_session,
    require_submap,
)
from revisit.service.ports.transactions import UnitOfWork


class Meshes(Protocol):
    """Meshes of submaps, made when they are asked for."""

    async def file(self, tenant: TenantId, key: SubmapKey, extension: str, room: Room) -> bytes:
        """The mesh of a submap as a file, once `room` has room for it. Raises NoAnswer, and the error of its worker."""
        ...


class Submaps:
    """Get, list, delete and download submaps."""

    def __init__(self, context: CallContext, work: ChargedWork, meshes: Meshes) -> None:
        """`work` and `meshes` make files."""
        self._context = context
        self._work = work
        self._meshes = meshes

    async def get(self, tenant: TenantId, key: SubmapKey, *, full: bool = False) -> SubmapView:
        """The submap, with its descriptor where `full`. Raises NotFound; DataLoss where that is damaged."""
        view = await self._context.storage.read(partial(_seen, tenant=tenant, key=key))
        if not full or view.state != SubmapState.DESCRIBED:
            return view
        return replace(view, place_descriptor=np.frombuffer(require_descriptor(view), dtype="<f4").astype(np.float32))

    async def list(self, tenant: TenantId, session: SessionKey, page: PageRequest) -> Page[SubmapView]:
        """The submaps of a session in their order. Raises NotFound for the session."""
        find = partial(_of_session, tenant=tenant, session=session)
        return await self._context.lists.page(tenant, page, find, as_it_is)

    async def delete(self, tenant: TenantId, key: SubmapKey) -> None:
        """Delete a submap, its loop closures and its entry in the index. Raises NotFound, Draining."""
        self._context.admission.require_running()
        entry = audit.noted(tenant, "submap_deleted", key.name)
        delete = partial(_delete, key=key, entry=entry, at_ns=self._context.clock.wall_ns())
        await self._context.storage.write(delete)
        failpoint("delete.after_rows")

    async def download(
        self,
        tenant: TenantId,
        key: SubmapKey,
        kind: DownloadKind,
        file_format: str | None = None,
        room: Room = any_room,
    ) -> Download:
        """The submap as a file. Formats: mesh ply or glb; points pcd, ply or npy; neural and descriptor have their own.

        Points are put together when `room` has room for them; a mesh is made by a worker, which is waited for. Raises
        NotFound; NotReady where it is not described yet; UnsupportedEncoding for another format; DataLoss; RateLimited;
        for a mesh also NoAnswer, WorkersBusy, StorageFull.
        """
        record, source = await self._context.storage.read(partial(self._with_source, tenant=tenant, key=key))
        extension = extension_of(kind, file_format)
        if kind is DownloadKind.MESH:
            require_neural_map(record)
            return named(await self._meshes.file(tenant, key, extension, room), record, kind, extension)
        await room(RENDERING_BYTES)

        def make() -> Download:
            return named(
                stored_file(self._context.storage.blobs, record, source, kind, extension), record, kind, extension
            )

        return await self._work.of(tenant, make)

    def _with_source(self, uow: UnitOfWork, tenant: TenantId, key: SubmapKey) -> tuple[SubmapRecord, SubmapSource]:
        record = require_submap(uow, tenant, key)
        return record, submap_source(uow, self._context.policy, record)


def _seen(uow: UnitOfWork, tenant: TenantId, key: SubmapKey) -> SubmapView:
    record = require_submap(uow, tenant, key)
    return SubmapView.of(record, submap_in_map(uow, record))


def _of_session(uow: UnitOfWork, after: int, limit: int, *, tenant: TenantId, session: SessionKey) -> list[SubmapView]:
    require_session(uow, tenant, session)
    of_session = {"map_id": session.map_id, "session_id": session.session_id}
    records = uow.submaps.find(tenant, after=after, limit=limit, **of_session)
    frames = MapFrames(uow, tenant, session.map_id)
    return [SubmapView.of(record, frames.submap(record)) for record in records]


def _delete(uow: UnitOfWork, key: SubmapKey, entry: AuditEntry, at_ns: int) -> None:
    tenant = TenantId(entry.tenant)
    of_map = require_map(uow, tenant, key.map_id, hold=True)
    record = require_submap(uow, tenant, key)
    audit.append(uow, at_ns, entry)
    delete_submap(uow, of_map, record, at_ns)
