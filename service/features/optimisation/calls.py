"""Versions of a map: optimise it, look at its versions and their poses, bring an earlier one back."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import DataLoss
from revisit.core.geometry.se3 import Matrix4
from revisit.service.domain import limits
from revisit.service.domain.errors import NotFound
from revisit.service.domain.identity import SubmapKey, TenantId
from revisit.service.domain.records import MapRecord, MapVersionRecord, SessionPosesRecord
from revisit.service.domain.states import LoopState
from revisit.service.failpoints import failpoint
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.features.graph.odometry_faults import faults_of
from revisit.service.features.graph.posting import (
    brought_forward,
    drop_waiting,
    post_optimisation,
    waiting_optimisation,
)
from revisit.service.features.graph.session_poses import (
    PackedSubmaps,
    hash_of_loops,
    hash_of_version,
    unpack_loops,
)
from revisit.service.features.optimisation.rows import MAP_REVERTED, forget_versions, judge_loops, tell_anchors
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, as_it_is
from revisit.service.features.resources.views import PostedOperation
from revisit.service.ports.map_optimiser import AUDITED, FAULTS
from revisit.service.ports.storage import require_map
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class MapVersionView:
    """A version of a map; `summary` has the fields of a MapVersionSummary, `number` is the place of its row."""

    map_id: str
    version: int
    in_force: bool
    restored_from: int | None
    content_hash: str
    operation_id: str | None
    summary: dict[str, Any]
    created_at_ns: int
    number: int


@dataclass(frozen=True)
class SubmapPoseView:
    """Where a submap lies in a frame of the map; covariance (6, 6) of (x, y, z, rx, ry, rz) in the submap's frame.

    `number` is its place among the poses of the version, from 1.
    """

    key: SubmapKey
    T_map_submap: Matrix4
    frame: str
    covariance: NDArray[np.float32]
    number: int


class MapVersions:
    """Optimise, get, list and bring back."""

    def __init__(self, context: CallContext) -> None:
        """Versions are kept in the storage of the context."""
        self._context = context

    async def optimise(self, tenant: TenantId, map_id: str) -> PostedOperation:
        """Queue an optimisation; one that waits already is due at once. Raises NotFound, Draining."""
        self._context.admission.require_running()
        return await self._context.storage.write(partial(self._optimise, tenant=tenant, map_id=map_id))

    def _optimise(self, uow: UnitOfWork, tenant: TenantId, map_id: str) -> PostedOperation:
        require_map(uow, tenant, map_id, hold=True)
        waiting = waiting_optimisation(uow, tenant, map_id, hold=True)
        if waiting is not None:
            return PostedOperation(brought_forward(uow, waiting), replay=True)
        posted = post_optimisation(uow, tenant, map_id, self._context.policy, self._context.clock.wall_ns())
        return PostedOperation(posted, replay=False)

    async def list(self, tenant: TenantId, map_id: str, page: PageRequest) -> Page[MapVersionView]:
        """The versions that are kept, oldest first. Raises NotFound for the map."""
        find = partial(_versions, tenant=tenant, map_id=map_id)
        return await self._context.lists.page(tenant, page, find, as_it_is)

    async def get(self, tenant: TenantId, map_id: str, version: int) -> MapVersionView:
        """Raises NotFound."""
        return await self._context.storage.read(partial(version_seen, tenant=tenant, map_id=map_id, version=version))

    async def poses(self, tenant: TenantId, map_id: str, version: int, page: PageRequest) -> Page[SubmapPoseView]:
        """The submaps of a version, by session and in the order of the drive. Raises NotFound."""
        find = partial(_poses, tenant=tenant, map_id=map_id, version=version)
        return await self._context.lists.page(tenant, page, find, as_it_is)

    async def revert(self, tenant: TenantId, map_id: str, version: int) -> MapVersionView:
        """Bring back the rows of an earlier version as a new one; the one in force is left as it is.

        An optimisation that waits is dropped, one that runs does not move the map again. Raises NotFound, Draining.
        """
        self._context.admission.require_running()
        limits.MAP_VERSION.validated(version, "version")
        entry = audit.noted(tenant, "map_reverted", f"maps/{map_id}", version=version)
        return await self._context.storage.write(partial(self._revert, map_id=map_id, version=version, entry=entry))

    def _revert(self, uow: UnitOfWork, map_id: str, version: int, entry: AuditEntry) -> MapVersionView:
        tenant, now_ns = TenantId(entry.tenant), self._context.clock.wall_ns()
        current = require_map(uow, tenant, map_id, hold=True)
        wanted = _require_version(uow, current, version)
        if version == current.map_version:
            return _view(uow, current, wanted)
        audit.append(uow, now_ns, entry)
        drop_waiting(uow, tenant, map_id, MAP_REVERTED, now_ns)
        restored, row = restore_version(uow, current, version, now_ns)
        failpoint("revert.after_rows")
        forget_versions(uow, tenant, map_id, restored.map_version - self._context.policy.map_versions_kept)
        return _view(uow, restored, row)


def restore_version(
    uow: UnitOfWork, current: MapRecord, version: int, now_ns: int
) -> tuple[MapRecord, MapVersionRecord]:
    """Bring back the rows of an earlier version as the one in force; 0 brings back a map without poses.

    Raises NotFound for a version that is not kept.
    """
    restored = replace(current, map_version=current.map_version + 1)
    wanted = _without_poses(current, now_ns) if version == 0 else _require_version(uow, current, version)
    row = _restore(uow, wanted, restored.map_version, now_ns)
    tell_anchors(uow, current, wanted.anchors)
    accepted = uow.loops.find(current.tenant, map_id=current.map_id, state=LoopState.ACCEPTED.value)
    judge_loops(uow, accepted, unpack_loops(wanted.loops), restored.map_version, now_ns)
    uow.maps.replace(restored)
    return restored, row


def _without_poses(current: MapRecord, now_ns: int) -> MapVersionRecord:
    """The summary of a map before its first version."""
    nothing: dict[str, Any] = dict.fromkeys(
        ("sessions", "submaps", "frames", "loops_in_map", "loops_set_aside", "loops_unconnected", "degrees_of_freedom"),
        0,
    )
    summary = {**nothing, "chi2": 0.0, "mean_change_m": None, "max_change_m": None}
    hashed = hash_of_loops(b"")
    return MapVersionRecord(current.tenant, current.map_id, 0, None, None, summary, b"", hashed, now_ns)


def _restore(uow: UnitOfWork, wanted: MapVersionRecord, version: int, now_ns: int) -> MapVersionRecord:
    """The rows of a version again, as a new one."""
    again: dict[str, Any] = {"version": version, "created_at_ns": now_ns, "number": 0}
    row = uow.map_versions.add(replace(wanted, **again, restored_from=wanted.version, operation_id=None))
    for poses in _sessions(uow, wanted):
        uow.session_poses.add(replace(poses, **again))
    return row


def _versions(uow: UnitOfWork, after: int, limit: int, *, tenant: TenantId, map_id: str) -> list[MapVersionView]:
    record = require_map(uow, tenant, map_id)
    rows = uow.map_versions.find(tenant, after=after, limit=limit, map_id=map_id)
    return [_view(uow, record, row) for row in rows]


def version_seen(uow: UnitOfWork, tenant: TenantId, map_id: str, version: int) -> MapVersionView:
    """A version of a map as clients see it. Raises NotFound."""
    record = require_map(uow, tenant, map_id)
    return _view(uow, record, _require_version(uow, record, version))


def _require_version(uow: UnitOfWork, record: MapRecord, version: int) -> MapVersionRecord:
    known = uow.map_versions.get(record.tenant, record.map_id, min(version, record.map_version + 1))
    if known is None:
        raise NotFound(f"there is no version {version} of map {record.map_id!r}"[:200])
    return known


def _view(uow: UnitOfWork, record: MapRecord, row: MapVersionRecord) -> MapVersionView:
    hashes = uow.session_poses.distinct(row.tenant, "content_hash", map_id=row.map_id, version=row.version)
    return MapVersionView(
        map_id=row.map_id,
        version=row.version,
        in_force=row.version == record.map_version,
        restored_from=row.restored_from,
        content_hash=hash_of_version(row, hashes),
        operation_id=row.operation_id,
        summary=_told(uow, row),
        created_at_ns=row.created_at_ns,
        number=row.number,
    )


def _told(uow: UnitOfWork, row: MapVersionRecord) -> dict[str, Any]:
    """The fields of a MapVersionSummary."""
    summary = {name: its for name, its in row.summary.items() if name != AUDITED}
    return {**summary, FAULTS: [asdict(fault) for fault in faults_of(uow, row)]}


def _sessions(uow: UnitOfWork, row: MapVersionRecord) -> list[SessionPosesRecord]:
    """The sessions of a version, oldest first."""
    rows = uow.session_poses.find(row.tenant, map_id=row.map_id, version=row.version)
    return sorted(rows, key=lambda poses: poses.session_number)


def _poses(
    uow: UnitOfWork, after: int, limit: int, *, tenant: TenantId, map_id: str, version: int
) -> list[SubmapPoseView]:
    row = _require_version(uow, require_map(uow, tenant, map_id), version)
    sessions = [(poses, PackedSubmaps.of(poses.submaps)) for poses in _sessions(uow, row)]
    places = [(poses, packed, place) for poses, packed in sessions for place in range(len(packed.numbers))]
    shown = places[after : after + limit]
    known = uow.submaps.numbered(tenant, [int(packed.numbers[place]) for _, packed, place in shown])
    if any(int(packed.numbers[place]) not in known for _, packed, place in shown):
        raise DataLoss(f"the poses of version {version} of the map are damaged")
    return [
        SubmapPoseView(
            key=SubmapKey(map_id, poses.session_id, known[int(packed.numbers[place])].submap_id),
            T_map_submap=packed.T_map_submap[place],
            frame=poses.frame,
            covariance=packed.covariances[place],
            number=number,
        )
        for number, (poses, packed, place) in enumerate(shown, after + 1)
    ]
