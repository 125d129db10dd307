"""Merges: make a map, or a session of it, a part of another map; list merges; take one back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4, pose_row
from revisit.service.capacity.backlog import same_job
from revisit.service.domain import limits
from revisit.service.domain.callers import current_actor
from revisit.service.domain.errors import NotFound, NotReady
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.records import MapMergeRecord
from revisit.service.domain.states import AnchorFrame, OperationKind
from revisit.service.failpoints import failpoint
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.features.deletion.erasure import Erasure
from revisit.service.features.deletion.rows import mark_session
from revisit.service.features.graph.posting import drop_waiting
from revisit.service.features.merging.reading import require_comparable
from revisit.service.features.optimisation.calls import restore_version
from revisit.service.features.optimisation.rows import MAP_REVERTED
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, as_it_is, rows_of_map
from revisit.service.features.resources.views import PostedOperation
from revisit.service.ports.map_optimiser import GEOREFERENCES
from revisit.service.ports.storage import require_map, require_session
from revisit.service.ports.transactions import UnitOfWork

DEFAULT_RADIUS_M = 30.0
"""How far from an initial pose loops may put two submaps, where nobody says."""


@dataclass(frozen=True)
class MergeMap:
    """Merge `source_map_id`, or one session of it, into `map_id`; with `validate_only` only a report.

    `T_map_source` (4, 4) is roughly where the frame of the source lies in that of the map, within `radius_m` metres.
    """

    map_id: str
    source_map_id: str
    source_session_id: str | None = None
    validate_only: bool = False
    T_map_source: Matrix4 | None = None
    radius_m: float | None = None

    def payload(self) -> dict[str, Any]:
        """Of the job. Raises BadField, BadTransform."""
        if self.source_map_id == self.map_id:
            raise BadField("the sessions of a map are in it already: optimise it instead", field="source")
        if self.radius_m is not None:
            limits.RADIUS_M.validated(self.radius_m, "radius_m")
            if self.T_map_source is None:
                raise BadField("radius_m is that of an initial pose, which is missing", field="radius_m")
        near = None if self.T_map_source is None else se3.validated(self.T_map_source)
        radius_m = DEFAULT_RADIUS_M if self.radius_m is None else self.radius_m
        return {
            "map_id": self.map_id,
            "source_map_id": self.source_map_id,
            "source_session_id": self.source_session_id,
            "validate_only": self.validate_only,
            "T_map_source": None if near is None else list(pose_row(near)),
            "radius_m": None if near is None else radius_m,
            "actor": current_actor(),
        }


class MapMerges:
    """Merge, list, get, take back."""

    def __init__(self, context: CallContext, erasure: Erasure) -> None:
        """The copies of a merge that is undone go through `erasure`."""
        self._context = context
        self._erasure = erasure

    async def merge(self, tenant: TenantId, command: MergeMap) -> PostedOperation:
        """Queue a merge; the same that waits already is answered.

        Raises NotFound; BadField; BadTransform; DescriptorModelMismatch where the maps were described by different
        models; WorkersBusy; Draining.
        """
        self._context.admission.require_running()
        payload = command.payload()
        return await self._context.storage.write(partial(self._post, tenant=tenant, command=command, payload=payload))

    async def list(self, tenant: TenantId, map_id: str, page: PageRequest) -> Page[MapMergeRecord]:
        """The merges into a map, oldest first, those taken back too. Raises NotFound for the map."""
        find = rows_of_map(lambda uow: uow.map_merges, tenant, map_id)
        return await self._context.lists.page(tenant, page, find, as_it_is)

    async def get(self, tenant: TenantId, map_id: str, merge_id: str) -> MapMergeRecord:
        """Raises NotFound."""
        return await self._context.storage.read(
            partial(_require_merge, tenant=tenant, map_id=map_id, merge_id=merge_id)
        )

    async def revert(self, tenant: TenantId, map_id: str, merge_id: str) -> MapMergeRecord:
        """Take a merge back: its copies are deleted, the poses from before it come back, bit for bit.

        Later additions to the map stay. Raises NotFound; NotReady where a later merge holds; Draining.
        """
        self._context.admission.require_running()
        entry = audit.noted(tenant, "merge_reverted", f"maps/{map_id}/merges/{merge_id}")
        work = partial(self._revert, map_id=map_id, merge_id=merge_id, entry=entry)
        reverted = await self._context.storage.write(work)
        await self._erasure.soon(tenant, map_id, *reverted.sessions)
        return reverted

    def _post(self, uow: UnitOfWork, tenant: TenantId, command: MergeMap, payload: dict[str, Any]) -> PostedOperation:
        target = require_map(uow, tenant, command.map_id, hold=True)
        source = require_map(uow, tenant, command.source_map_id)
        if command.source_session_id is not None:
            require_session(uow, tenant, SessionKey(command.source_map_id, command.source_session_id))
        require_comparable(target, source)
        subject = f"maps/{command.map_id}"
        waiting = same_job(uow, tenant, OperationKind.MERGE_MAP, subject, payload)
        if waiting is not None:
            return PostedOperation(waiting, replay=True)
        posted = self._context.jobs.post(uow, tenant, OperationKind.MERGE_MAP, subject, payload)
        return PostedOperation(posted, replay=False)

    def _revert(self, uow: UnitOfWork, map_id: str, merge_id: str, entry: AuditEntry) -> MapMergeRecord:
        tenant, now_ns = TenantId(entry.tenant), self._context.clock.wall_ns()
        require_map(uow, tenant, map_id, hold=True)
        merge = _require_merge(uow, tenant, map_id, merge_id)
        if merge.reverted_at_ns is not None:
            return merge
        later = uow.map_merges.find(tenant, after=merge.number, map_id=map_id, reverted_at_ns=None)
        if later:
            raise NotReady(f"merge {later[-1].merge_id} came later: take that back first")
        audit.append(uow, now_ns, entry)
        drop_waiting(uow, tenant, map_id, MAP_REVERTED, now_ns)
        _delete_copies(uow, merge, now_ns)
        _forget_origin(uow, merge)
        failpoint("unmerge.after_rows")
        restore_version(uow, require_map(uow, tenant, map_id), merge.version_before, now_ns)
        reverted = replace(merge, reverted_at_ns=now_ns)
        uow.map_merges.replace(reverted)
        failpoint("unmerge.after_version")
        return reverted


def _delete_copies(uow: UnitOfWork, merge: MapMergeRecord, now_ns: int) -> None:
    """Delete the copies that are still there."""
    record = require_map(uow, merge.tenant, merge.map_id)
    for session_id in merge.sessions:
        session = uow.sessions.get(merge.tenant, merge.map_id, session_id)
        if session is not None:
            mark_session(uow, record, session, now_ns)


def _forget_origin(uow: UnitOfWork, merge: MapMergeRecord) -> None:
    """A map lies on earth by an anchor of its own: where the copies alone had some, it has no origin again.

    Nor have the versions since the merge their places relative to it.
    """
    record = require_map(uow, merge.tenant, merge.map_id)
    if record.origin is None:
        return
    if uow.anchors.find(merge.tenant, limit=1, map_id=merge.map_id, frame=AnchorFrame.WGS84.value):
        return
    uow.maps.replace(replace(record, origin=None))
    for version in uow.map_versions.find(merge.tenant, map_id=merge.map_id):
        if version.version >= merge.version and GEOREFERENCES in version.summary:
            left = {name: one for name, one in version.summary.items() if name != GEOREFERENCES}
            uow.map_versions.replace(replace(version, summary=left))


def _require_merge(uow: UnitOfWork, tenant: TenantId, map_id: str, merge_id: str) -> MapMergeRecord:
    require_map(uow, tenant, map_id)
    known = uow.map_merges.get(tenant, map_id, merge_id)
    if known is None:
        raise NotFound(f"there is no merge {merge_id!r} of map {map_id!r}"[:200])
    return known
