"""Anchors of sessions: post, list and delete them; and ask what they would do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.pose_graph.anchors import AnchorReason, AnchorState
from revisit.service.capacity.charged_work import ChargedWork
from revisit.service.capacity.limits import ANCHOR_POINTS, STORED_ANCHOR_POINTS
from revisit.service.domain import limits
from revisit.service.domain.errors import NotFound
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.records import AnchorRecord, MapRecord, SessionRecord
from revisit.service.domain.states import OperationKind, SessionState
from revisit.service.features.anchors.rules import AnchorQuestion, DrivePoses, NewAnchor
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.features.graph.anchor_verdicts import anchor_verdicts, kept_anchors
from revisit.service.features.graph.anchors import is_another_site, move_origin, origin_by
from revisit.service.features.graph.edits import note_edit
from revisit.service.features.graph.posting import optimise_soon
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, as_it_is
from revisit.service.features.resources.views import PostedOperation
from revisit.service.ports.storage import require_map, require_same_content, require_session
from revisit.service.ports.transactions import UnitOfWork

SCANS_AT_ONCE = 200
"""Scans that are read to find the poses of anchors between them: those of 20 s of a drive."""


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
    """Post, preview, list and delete."""

    def __init__(self, context: CallContext, work: ChargedWork) -> None:
        """Anchors are kept in the storage of the context; `work` has a turn for whoever looks for their poses."""
        self._context = context
        self._work = work

    async def post(self, tenant: TenantId, key: SessionKey, anchors: Sequence[NewAnchor]) -> list[AnchorView]:
        """Store anchors of a session, all or none; those that are there with the same content are passed over.

        The map is optimised with them once the session has ended. Raises BadField, also where the scans do not tell the
        pose at a time; NotFound; AlreadyExists for other content; Draining, RateLimited, QuotaReached.
        """
        rows, now_ns = await self._rows(tenant, key, anchors), self._context.clock.wall_ns()
        new = await self._context.storage.read(partial(_count_new, rows=rows))
        if new:
            await self._context.admission.require_room(tenant)
        post = partial(self._post, tenant=tenant, key=key, rows=rows, now_ns=now_ns)
        posted = await self._context.storage.write(post)
        self._context.admission.note_stored(tenant, new * STORED_ANCHOR_POINTS)
        return posted

    async def _rows(self, tenant: TenantId, key: SessionKey, anchors: Sequence[NewAnchor]) -> list[AnchorRecord]:
        """The rows of anchors to post. Raises as `post`."""
        limits.ANCHORS.validated(len(anchors), "anchors")
        posted = [one.validated() for one in anchors]
        self._context.admission.charge_creation(tenant, ANCHOR_POINTS * len(posted))
        poses = await self._sensor_poses(tenant, key, posted)
        now_ns = self._context.clock.wall_ns()
        return [one.record(tenant, key, T, now_ns) for one, T in zip(posted, poses, strict=True)]

    async def preview(self, tenant: TenantId, key: SessionKey, anchors: Sequence[NewAnchor]) -> PostedOperation:
        """Queue the question of what anchors would do to the map; the same one that has not ended is answered.

        Raises as `post`, and WorkersBusy.
        """
        rows = _distinct([replace(one, created_at_ns=0) for one in await self._rows(tenant, key, anchors)])
        payload = AnchorQuestion(key.map_id, tuple(rows)).payload()
        return await self._context.storage.write(partial(self._ask, tenant=tenant, key=key, rows=rows, payload=payload))

    def _ask(
        self, uow: UnitOfWork, tenant: TenantId, key: SessionKey, rows: Sequence[AnchorRecord], payload: dict[str, Any]
    ) -> PostedOperation:
        require_map(uow, tenant, key.map_id, hold=True)
        new = _count_new(uow, rows)
        if new:
            _require_room(uow, tenant, key, new)
        asked, replay = self._context.jobs.ask(uow, tenant, OperationKind.PREVIEW_ANCHORS, key.name, payload)
        return PostedOperation(asked, replay)

    async def _sensor_poses(self, tenant: TenantId, key: SessionKey, anchors: Sequence[NewAnchor]) -> list[Matrix4]:
        """See the function; what is read of scans is charged."""
        find = partial(_sensor_poses, tenant=tenant, key=key, anchors=anchors)
        if all(one.T_odom_sensor is not None for one in anchors):
            return await self._context.storage.read(find)
        return await self._work.of(tenant, partial(self._context.storage.transactions.read_here, find))

    def _post(
        self, uow: UnitOfWork, tenant: TenantId, key: SessionKey, rows: Sequence[AnchorRecord], now_ns: int
    ) -> list[AnchorView]:
        of_map = require_map(uow, tenant, key.map_id, hold=True)
        session = require_session(uow, tenant, key, hold=True)
        origin = origin_by(of_map, rows)
        if origin != of_map.origin:
            uow.maps.replace(replace(of_map, origin=origin))
        stored, added = _stored(uow, session, rows)
        if is_another_site(origin, rows):
            move_origin(uow, tenant, key.map_id)
        if added and session.state == SessionState.FINISHED:
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
        of_map = require_map(uow, tenant, key.map_id, hold=True)
        require_session(uow, tenant, key)
        row = uow.anchors.get(tenant, key.map_id, key.session_id, anchor_id)
        if row is None:
            raise NotFound(f"there is no anchor {anchor_id!r} of {key.name}"[:300])
        uow.anchors.delete(tenant, number=row.number)
        if row.position == of_map.origin:
            move_origin(uow, tenant, key.map_id)
        audit.append(uow, now_ns, entry)
        note_edit(uow, tenant, key.map_id)
        optimise_soon(uow, tenant, key.map_id, self._context.policy, now_ns, decided=True)


def _stored(uow: UnitOfWork, session: SessionRecord, rows: Sequence[AnchorRecord]) -> tuple[list[AnchorRecord], int]:
    """The rows, added where they are not there, and how many were added.

    Raises AlreadyExists where one of an id has other content, BadField where the session would have too many.
    """
    stored, added = list[AnchorRecord](), 0
    for row in rows:
        known = _known(uow, row)
        stored.append(known or uow.anchors.add(row))
        added += known is None
    if added:
        _require_room(uow, TenantId(session.tenant), session.key)
    return stored, added


def _distinct(rows: Sequence[AnchorRecord]) -> list[AnchorRecord]:
    """Each anchor once. Raises AlreadyExists where two of an id have other content."""
    found = dict[str, AnchorRecord]()
    for row in rows:
        first = found.setdefault(row.anchor_id, row)
        require_same_content(first.content_hash, row.content_hash, f"anchor {row.anchor_id}")
    return list(found.values())


def _require_room(uow: UnitOfWork, tenant: TenantId, key: SessionKey, more: int = 0) -> None:
    """Raises BadField where a session with so many `more` anchors would have too many."""
    if uow.anchors.count(tenant, map_id=key.map_id, session_id=key.session_id) + more > limits.ANCHORS_OF_SESSION:
        raise BadField(f"a session has at most {limits.ANCHORS_OF_SESSION} anchors", field="anchors")


def _count_new(uow: UnitOfWork, rows: Sequence[AnchorRecord]) -> int:
    """How many of them are not stored yet. Raises AlreadyExists where one of an id has other content."""
    return sum(_known(uow, row) is None for row in rows)


def _known(uow: UnitOfWork, row: AnchorRecord) -> AnchorRecord | None:
    """The stored anchor of this id. Raises AlreadyExists where it has other content."""
    known = uow.anchors.get(TenantId(row.tenant), row.map_id, row.session_id, row.anchor_id)
    if known is not None:
        require_same_content(known.content_hash, row.content_hash, f"anchor {row.anchor_id}")
    return known


def _sensor_poses(uow: UnitOfWork, tenant: TenantId, key: SessionKey, anchors: Sequence[NewAnchor]) -> list[Matrix4]:
    """T_odom_sensor (4, 4) of anchors: as told, or between the scans around them. Raises NotFound, BadField."""
    require_session(uow, tenant, key)
    found, drive = dict[int, Matrix4 | None](), DrivePoses([], [])
    for stamp_ns in sorted(one.stamp_ns for one in anchors if one.T_odom_sensor is None):
        if drive.at(stamp_ns) is None:
            scans = uow.scans.around(tenant, key.map_id, key.session_id, stamp_ns, SCANS_AT_ONCE)
            drive = DrivePoses([scan.stamp_ns for scan in scans], [scan.T_odom_sensor for scan in scans])
        found[stamp_ns] = drive.at(stamp_ns)
    return [_pose_of(found.get(one.stamp_ns), one) for one in anchors]


def _pose_of(T_odom_sensor: Matrix4 | None, anchor: NewAnchor) -> Matrix4:
    """As the anchor tells it, or else as the scans do."""
    if anchor.T_odom_sensor is not None:
        return se3.validated(anchor.T_odom_sensor)
    if T_odom_sensor is None:
        message = f"anchor {anchor.anchor_id} needs T_odom_sensor: no scans are stored before and after its time"
        raise BadField(message, field="t_odom_sensor")
    return T_odom_sensor


def _anchors(uow: UnitOfWork, after: int, limit: int, *, tenant: TenantId, key: SessionKey) -> list[AnchorView]:
    of_map = require_map(uow, tenant, key.map_id)
    require_session(uow, tenant, key)
    return _judged(
        uow, of_map, uow.anchors.find(tenant, after=after, limit=limit, map_id=key.map_id, session_id=key.session_id)
    )


def anchors_seen(uow: UnitOfWork, tenant: TenantId, map_id: str, numbers: Sequence[int]) -> dict[int, AnchorView]:
    """Those of these anchors of a map (at most 1000) that are there, by number."""
    of_map, rows = uow.maps.get(tenant, map_id), uow.anchors.numbered(tenant, numbers)
    return {} if of_map is None else {one.number: one for one in _judged(uow, of_map, [*rows.values()])}


def _judged(uow: UnitOfWork, of_map: MapRecord, rows: Sequence[AnchorRecord]) -> list[AnchorView]:
    """Anchors of a map with the verdicts of the version in force."""
    version = uow.map_versions.get(of_map.tenant, of_map.map_id, of_map.map_version)
    data = None if version is None else version.anchors
    known = anchor_verdicts(kept_anchors(data, [row.number for row in rows]))
    return [_seen(row, *known.get(row.number, (None, None, None))) for row in rows]


def _seen(
    row: AnchorRecord,
    state: AnchorState | None,
    reason: AnchorReason | None,
    residual_m: NDArray[np.float64] | None,
) -> AnchorView:
    found = residual_m is not None and bool(np.isfinite(residual_m).all())
    return AnchorView(row, state, reason, residual_m if found else None)
