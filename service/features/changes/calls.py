"""What changed between the drives of a version of a map, as clients list it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from revisit.service.capacity.charged_work import ChargedWork
from revisit.service.domain import limits
from revisit.service.domain.errors import NoAnswer
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.states import OperationKind
from revisit.service.features.changes.rows import FoundChanges, MapChange, stored_changes
from revisit.service.features.operations.calls import Operations
from revisit.service.features.operations.joined_jobs import JoinedJobs
from revisit.service.features.optimisation.calls import version_seen
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, as_it_is
from revisit.service.ports.blobs import TILE_BLOB
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class MapChangeView:
    """A change, the session that found it, and its place in the order of time."""

    change: MapChange
    session: SessionKey
    number: int


class MapChanges:
    """Lists the changes of a version; a worker looks for them when somebody asks for the first time."""

    def __init__(self, context: CallContext, operations: Operations, work: ChargedWork) -> None:
        """`operations` waits for the worker; `work` has a turn for each that reads what a worker found."""
        self._context = context
        self._work = work
        self._jobs = JoinedJobs(context, operations)

    async def list(
        self, tenant: TenantId, map_id: str, version: int, page: PageRequest, after_ns: int = 0, until_ns: int = 0
    ) -> Page[MapChangeView]:
        """What was found changed after one moment, up to another (0: without end), in the order of time.

        Raises NotFound, BadField, NoAnswer while squares are still compared, DataLoss.
        """
        limits.STAMP_NS.validated(after_ns, "after_ns")
        limits.STAMP_NS.validated(until_ns, "until_ns")
        found = await self._found(tenant, map_id, version)
        ids = await self._context.storage.read(partial(_sessions, tenant=tenant, map_id=map_id, version=version))
        views = [
            MapChangeView(one, SessionKey(map_id, ids[one.session]), number)
            for number, one in enumerate(found.changes, 1)
            if one.session in ids
            and (not after_ns or after_ns < one.stamp_ns)
            and (not until_ns or one.stamp_ns <= until_ns)
        ]
        return await self._context.lists.page(tenant, page, partial(_following, views=views), as_it_is)

    async def _found(self, tenant: TenantId, map_id: str, version: int) -> FoundChanges:
        """All changes of a version in the order of time, looked for where that has not ended."""
        found = await self._stored(tenant, map_id, version)
        if found is None or not found.complete:
            payload, subject = {"map_id": map_id, "version": version}, f"maps/{map_id}/versions/{version}"
            await self._jobs.answer(tenant, OperationKind.FIND_CHANGES, subject, payload)
            found = await self._stored(tenant, map_id, version)
        if found is None or not found.complete:
            compared = "" if found is None else f": {found.compared} of {found.squares} squares of the map are"
            raise NoAnswer(f"the drives are being compared{compared}; ask again")
        return found

    async def _stored(self, tenant: TenantId, map_id: str, version: int) -> FoundChanges | None:
        def known(uow: UnitOfWork) -> str | None:
            version_seen(uow, tenant, map_id, version)
            return stored_changes(uow, tenant, map_id, version)

        sha256 = await self._context.storage.read(known)
        if sha256 is None:
            return None
        return await self._work.of(tenant, partial(self._read, tenant, sha256))

    def _read(self, tenant: TenantId, sha256: str) -> FoundChanges:
        """Those of a large map are megabytes, which each page of their list reads."""
        found = FoundChanges.of(self._context.storage.blobs.get(tenant, TILE_BLOB, sha256))
        return replace(found, changes=tuple(sorted(found.changes, key=lambda one: one.order)))


def _sessions(uow: UnitOfWork, tenant: TenantId, map_id: str, version: int) -> dict[int, str]:
    """The ids of the sessions of a version by their numbers."""
    rows = uow.session_poses.find(tenant, map_id=map_id, version=version)
    return {row.session_number: row.session_id for row in rows}


def _following(_uow: UnitOfWork, after: int, limit: int, views: Sequence[MapChangeView]) -> list[MapChangeView]:
    return [one for one in views if one.number > after][:limit]
