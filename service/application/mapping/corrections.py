"""Corrections: where the odometry frame of a session lies in the map, now and as the map changes."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.service.application.capacity.admission import Admission
from revisit.service.application.contract.errors import NotReady
from revisit.service.application.contract.identity import SessionKey, TenantId
from revisit.service.application.contract.records import SessionPosesRecord
from revisit.service.application.contract.session_poses import PackedSubmaps
from revisit.service.application.contract.storage import Storage, require_map, require_session
from revisit.service.application.contract.transactions import UnitOfWork
from revisit.service.application.query.glance import Glance


@dataclass(frozen=True)
class CorrectionView:
    """T_map_odom (4, 4) of a session by a version of its map, as of its last submap there.

    Covariance (6, 6) of that submap's pose in the map: of (x, y, z, rx, ry, rz) in the submap's frame.
    """

    session: SessionKey
    T_map_odom: Matrix4
    frame: str
    map_version: int
    covariance: NDArray[np.float32]
    created_at_ns: int


class Corrections:
    """Get and watch the corrections of sessions."""

    def __init__(self, storage: Storage, admission: Admission, glance: Glance) -> None:
        """Watching ends when `admission` says that the service stops; `glance` sees that there is news."""
        self._storage = storage
        self._admission = admission
        self._glance = glance

    async def get(self, tenant: TenantId, key: SessionKey) -> CorrectionView:
        """By the version in force. Raises NotFound; NotReady where that does not have the session."""
        return await self._storage.read(partial(_correction, tenant=tenant, key=key))

    async def watch(
        self, tenant: TenantId, map_id: str, after: int = 0, session_id: str | None = None
    ) -> AsyncIterator[CorrectionView]:
        """The corrections by the version in force where it is above `after`, then by each that follows.

        Of versions that follow fast, the newest counts. Ends when the service stops. Raises NotFound for the map and
        the session.
        """
        while not self._admission.stopping:
            looked_at = self._glance.last
            known = partial(_newer, tenant=tenant, map_id=map_id, after=after, session_id=session_id)
            after, corrections = await self._storage.read(known)
            for correction in corrections:
                yield correction
            await self._glance.beyond(tenant, map_id, looked_at)


def _correction(uow: UnitOfWork, tenant: TenantId, key: SessionKey) -> CorrectionView:
    require_session(uow, tenant, key)
    version = require_map(uow, tenant, key.map_id).map_version
    row = uow.session_poses.get(tenant, key.map_id, version, key.session_id)
    if row is None:
        raise NotReady(f"no version of map {key.map_id} has session {key.session_id} yet")
    return _view(row)


def _newer(
    uow: UnitOfWork, tenant: TenantId, map_id: str, after: int, session_id: str | None
) -> tuple[int, list[CorrectionView]]:
    version = require_map(uow, tenant, map_id).map_version
    if session_id is not None:
        require_session(uow, tenant, SessionKey(map_id, session_id))
    if version <= after:
        return after, []
    of_session: dict[str, Any] = {} if session_id is None else {"session_id": session_id}
    rows = uow.session_poses.find(tenant, map_id=map_id, version=version, **of_session)
    return version, [_view(row) for row in sorted(rows, key=lambda row: row.session_number)]


def _view(row: SessionPosesRecord) -> CorrectionView:
    return CorrectionView(
        session=SessionKey(row.map_id, row.session_id),
        T_map_odom=pose_matrix(row.T_map_odom),
        frame=row.frame,
        map_version=row.version,
        covariance=PackedSubmaps.of(row.submaps).covariances[-1],
        created_at_ns=row.created_at_ns,
    )
