"""Anchors of sessions: post, list and delete."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.pose_graph.anchors import AnchorReason, AnchorState
from revisit.service.domain import limits
from revisit.service.domain.errors import NotFound
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.records import AnchorRecord, SessionRecord
from revisit.service.domain.states import AnchorFrame, SessionState
from revisit.service.features.anchors.rules import DrivePoses, NewAnchor
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.features.graph.anchor_verdicts import anchor_verdicts
from revisit.service.features.graph.edits import note_edit
from revisit.service.features.graph.posting import optimise_soon
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, as_it_is
from revisit.service.ports.storage import require_map, require_same_content, require_session
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class AnchorView:
    """An anchor with the verdict of the version in force; residual_m (3,) is None where nothing is aligned."""

    record: AnchorRecord
    state: AnchorState | None = None
    reason: AnchorReason | None = None
    residual_m: NDArray[np.float64] | None = None

    @property
    def number(self) -> int:
        """That of the row."""
        return self.record.number


class Anchors:
    """Post, list and delete."""

    def __init__(self, context: CallContext) -> None:
        """Anchors are kept in the storage of the context."""
        self._context = context

    async def post(self, tenant: TenantId, key: SessionKey, anchors: Sequence[NewAnchor]) -> list[AnchorView]:
        """Store anchors of a session, all or none; those that are there with the same content are passed over.

        The map is optimised with them once the session has ended. Raises BadField, also where the scans do not tell the
        pose at a time; NotFound; AlreadyExists for other content; Draining, RateLimited.
        """
        limits.ANCHORS.validated(len(anchors), "anchors")
        posted = [one.validated() for one in anchors]
        self._context.admission.charge_creation(tenant)
        poses = await self._context.storage.read(partial(_sensor_poses, tenant=tenant, key=key, anchors=posted))
        now_ns = self._context.clock.wall_ns()
        rows = [one.record(tenant, key, T, now_ns) for one, T in zip(posted, poses, strict=True)]
        return await self._context.storage.write(partial(self._post, tenant=tenant, key=key, rows=rows, now_ns=now_ns))

    def _post(
        self, uow: UnitOfWork, tenant: TenantId, key: SessionKey, rows: Sequence[AnchorRecord], now_ns: int
    ) -> list[AnchorView]:
        of_map = require_map(uow, tenant, key.map_id, hold=True)
        session = require_session(uow, tenant, key, hold=True)
        first = next((row for row in rows if row.frame == AnchorFrame.WGS84), None)
        if of_map.origin is None and first is not None:
            uow.maps.replace(replace(of_map, origin=first.position))
        _require_room(uow, session, len(rows))
        stored = [_stored(uow, row) for row in rows]
        if session.state == SessionState.FINISHED:
            optimise_soon(uow, tenant, key.map_id, self._context.policy, now_ns, decided=True)
        return [AnchorView(row) for row in stored]

    async def list(self, tenant: TenantId, key: SessionKey, page: PageRequest) -> Page[AnchorView]:
        """The anchors of a session, in the order in which they came. Raises NotFound."""
        return await self._context.lists.page(tenant, page, partial(_anchors, tenant=tenant, key=key), as_it_is)

    async def delete(self, tenant: TenantId, map_id: str, session_id: str, anchor_id: str) -> None:
        """Delete an anchor; the map is optimised without it. Raises NotFound, Draining."""
        self._context.admission.require_running()
        key = SessionKey(map_id, session_id)
        entry = audit.noted(tenant, "anchor_deleted", f"{key.name}/anchors/{anchor_id}")
        now_ns = self._context.clock.wall_ns()
        await self._context.storage.write(
            partial(self._delete, key=key, anchor_id=anchor_id, entry=entry, now_ns=now_ns)
        )

    def _delete(self, uow: UnitOfWork, key: SessionKey, anchor_id: str, entry: AuditEntry, now_ns: int) -> None:
        tenant = TenantId(entry.tenant)
        require_map(uow, tenant, key.map_id, hold=True)
        require_session(uow, tenant, key)
        row = uow.anchors.get(tenant, key.map_id, key.session_id, anchor_id)
        if row is None:
            raise NotFound(f"there is no anchor {anchor_id!r} of {key.name}"[:300])
        uow.anchors.delete(tenant, number=row.number)
        audit.append(uow, now_ns, entry)
        note_edit(uow, tenant, key.map_id)
        optimise_soon(uow, tenant, key.map_id, self._context.policy, now_ns, decided=True)


def _stored(uow: UnitOfWork, row: AnchorRecord) -> AnchorRecord:
    """The row, added where it is not there. Raises AlreadyExists where one of its id has other content."""
    known = uow.anchors.get(TenantId(row.tenant), row.map_id, row.session_id, row.anchor_id)
    if known is None:
        return uow.anchors.add(row)
    require_same_content(known.content_hash, row.content_hash, f"anchor {row.anchor_id}")
    return known


def _require_room(uow: UnitOfWork, session: SessionRecord, more: int) -> None:
    """Raises BadField where a session would have too many anchors."""
    tenant = TenantId(session.tenant)
    if (
        uow.anchors.count(tenant, map_id=session.map_id, session_id=session.session_id) + more
        > limits.ANCHORS_OF_SESSION
    ):
        raise BadField(f"a session has at most {limits.ANCHORS_OF_SESSION} anchors", field="anchors")


def _sensor_poses(uow: UnitOfWork, tenant: TenantId, key: SessionKey, anchors: Sequence[NewAnchor]) -> list[Matrix4]:
    """T_odom_sensor (4, 4) of anchors: as told, or between the scans around them. Raises NotFound, BadField."""
    require_session(uow, tenant, key)
    if all(one.T_odom_sensor is not None for one in anchors):
        return [se3.validated(one.T_odom_sensor) for one in anchors]  # type: ignore[arg-type]  # none of them is None
    stamps_ns = [one.stamp_ns for one in anchors if one.T_odom_sensor is None]
    scans = uow.scans.around(tenant, key.map_id, key.session_id, min(stamps_ns), max(stamps_ns))
    drive = DrivePoses([scan.stamp_ns for scan in scans], [scan.T_odom_sensor for scan in scans])
    return [_pose_of(drive, one) for one in anchors]


def _pose_of(drive: DrivePoses, anchor: NewAnchor) -> Matrix4:
    if anchor.T_odom_sensor is not None:
        return se3.validated(anchor.T_odom_sensor)
    T_odom_sensor = drive.at(anchor.stamp_ns)
    if T_odom_sensor is None:
        message = f"anchor {anchor.anchor_id} needs T_odom_sensor: no scans are stored before and after its time"
        raise BadField(message, field="t_odom_sensor")
    return T_odom_sensor


def _anchors(uow: UnitOfWork, after: int, limit: int, *, tenant: TenantId, key: SessionKey) -> list[AnchorView]:
    of_map = require_map(uow, tenant, key.map_id)
    require_session(uow, tenant, key)
    rows = uow.anchors.find(tenant, after=after, limit=limit, map_id=key.map_id, session_id=key.session_id)
    version = uow.map_versions.get(tenant, key.map_id, of_map.map_version)
    known = anchor_verdicts(None if version is None else version.anchors)
    return [_seen(row, *known.get(row.number, (None, None, None))) for row in rows]


def _seen(
    row: AnchorRecord,
    state: AnchorState | None,
    reason: AnchorReason | None,
    residual_m: NDArray[np.float64] | None,
) -> AnchorView:
    found = residual_m is not None and bool(np.isfinite(residual_m).all())
    return AnchorView(row, state, reason, residual_m if found else None)
