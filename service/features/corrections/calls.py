"""Corrections: where the odometry frame of a session lies in the map, now and as the map changes."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.service.domain.errors import NotReady
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.records import EarlyCorrectionRecord, MapVersionRecord, SessionPosesRecord
from revisit.service.features.graph.odometry_faults import OdometryFaultView, faults_of
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.waiting.event_tail import AGAIN_S, EventTail
from revisit.service.ports.storage import require_map, require_session
from revisit.service.ports.transactions import UnitOfWork

SOON_S = 0.3
"""A loop is in the log of events before its corrections are stored: a watch looks again after so long."""


@dataclass(frozen=True)
class CorrectionView:
    """T_map_odom (4, 4) of a session by a version of its map, as of its last submap there.

    Covariance (6, 6) of that submap's pose in the map: of (x, y, z, rx, ry, rz) in the submap's frame.
    `early_loops` is not 0 where single loops have moved the session since: then T_map_odom is as of its last submap of
    all, until a version says more. `odometry_faults` are those of the session by the version.
    """

    session: SessionKey
    T_map_odom: Matrix4
    frame: str
    map_version: int
    covariance: NDArray[np.float32]
    created_at_ns: int
    early_loops: int = 0
    odometry_faults: tuple[OdometryFaultView, ...] = ()


class Corrections:
    """Get and watch the corrections of sessions."""

    def __init__(self, context: CallContext, tail: EventTail) -> None:
        """`tail` sees that there is news."""
        self._context = context
        self._tail = tail

    async def get(self, tenant: TenantId, key: SessionKey) -> CorrectionView:
        """By the version in force. Raises NotFound; NotReady where that does not have the session."""
        return await self._context.storage.read(partial(_correction, tenant=tenant, key=key))

    async def watch(
        self, tenant: TenantId, map_id: str, after: int = 0, session_id: str | None = None
    ) -> AsyncIterator[CorrectionView]:
        """The corrections by the version in force where it is above `after`, then by each that follows.

        Those ahead of a version come as they are made. Of those that follow fast, the newest counts. Ends when the
        service stops. Raises NotFound for the map and the session.
        """
        early, before, last = dict[str, int](), 0, 0
        while not self._context.admission.stopping:
            known = partial(_newer, tenant=tenant, map_id=map_id, after=after, session_id=session_id, early=early)
            after, corrections = await self._context.storage.read(known)
            for correction in corrections:
                early[correction.session.session_id] = correction.early_loops
                yield correction
            at_most_s = SOON_S if last > before else AGAIN_S
            before, last = last, await self._tail.beyond(tenant, map_id, last, at_most_s)


def _correction(uow: UnitOfWork, tenant: TenantId, key: SessionKey) -> CorrectionView:
    require_session(uow, tenant, key)
    version = require_map(uow, tenant, key.map_id).map_version
    row = uow.session_poses.get(tenant, key.map_id, version, key.session_id)
    if row is None:
        raise NotReady(f"no version of map {key.map_id} has session {key.session_id} yet")
    of_version = uow.map_versions.get(tenant, key.map_id, version)
    return _view(uow, row, uow.early_corrections.get(tenant, key.map_id, key.session_id), of_version)


def _newer(
    uow: UnitOfWork, tenant: TenantId, map_id: str, after: int, session_id: str | None, early: dict[str, int]
) -> tuple[int, list[CorrectionView]]:
    """The version in force, and its news: of a version above `after` everything."""
    version = require_map(uow, tenant, map_id).map_version
    if session_id is not None:
        require_session(uow, tenant, SessionKey(map_id, session_id))
    of_session: dict[str, Any] = {} if session_id is None else {"session_id": session_id}
    ahead = {row.session_id: row for row in uow.early_corrections.find(tenant, map_id=map_id, **of_session)}
    loops = {name: row.loops for name, row in ahead.items() if row.version == version}
    if version <= after and loops == {name: known for name, known in early.items() if known}:
        return after, []
    rows = uow.session_poses.find(tenant, map_id=map_id, version=version, **of_session)
    rows = sorted(rows, key=lambda row: row.session_number)
    of_version = uow.map_versions.get(tenant, map_id, version)
    views = [_view(uow, row, ahead.get(row.session_id), of_version) for row in rows]
    changed = [view for view in views if version > after or view.early_loops != early.get(view.session.session_id, 0)]
    return max(version, after), changed


def _view(
    uow: UnitOfWork, row: SessionPosesRecord, ahead: EarlyCorrectionRecord | None, version: MapVersionRecord | None
) -> CorrectionView:
    early = ahead if ahead is not None and ahead.version == row.version else None
    return CorrectionView(
        session=SessionKey(row.map_id, row.session_id),
        T_map_odom=pose_matrix(row.T_map_odom if early is None else early.T_map_odom),
        frame=row.frame,
        map_version=row.version,
        covariance=PackedSubmaps.of(row.submaps).covariances[-1],
        created_at_ns=row.created_at_ns if early is None else early.created_at_ns,
        early_loops=0 if early is None else early.loops,
        odometry_faults=faults_of(uow, version, row.session_id),
    )
