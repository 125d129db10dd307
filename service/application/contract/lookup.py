"""Finding a resource by its key, or refusing with NotFound."""

from __future__ import annotations

from revisit.service.application.contract.errors import NotFound, SessionFinished
from revisit.service.application.contract.identity import SessionKey, SubmapKey, TenantId
from revisit.service.application.contract.records import JobRecord, MapRecord, RobotRecord, SessionRecord, SubmapRecord
from revisit.service.application.contract.states import SessionState
from revisit.service.application.contract.transactions import UnitOfWork


def require_map(uow: UnitOfWork, tenant: TenantId, map_id: str) -> MapRecord:
    """The map. Raises NotFound."""
    record = uow.maps.get(tenant, map_id)
    if record is None:
        raise NotFound(f"there is no map {map_id!r}"[:200])
    return record


def require_robot(uow: UnitOfWork, tenant: TenantId, robot_id: str) -> RobotRecord:
    """The robot. Raises NotFound."""
    record = uow.robots.get(tenant, robot_id)
    if record is None:
        raise NotFound(f"there is no robot {robot_id!r}"[:200])
    return record


def require_session(uow: UnitOfWork, tenant: TenantId, key: SessionKey) -> SessionRecord:
    """The session. Raises NotFound."""
    record = uow.sessions.get(tenant, key.map_id, key.session_id)
    if record is None:
        raise NotFound(f"there is no session {key.name!r}"[:300])
    return record


def require_active(session: SessionRecord) -> None:
    """Raises SessionFinished unless the session takes data."""
    if session.state != SessionState.ACTIVE:
        raise SessionFinished(f"session {session.session_id} is finished")


def require_submap(uow: UnitOfWork, tenant: TenantId, key: SubmapKey) -> SubmapRecord:
    """The submap. Raises NotFound."""
    record = uow.submaps.get(tenant, key.map_id, key.session_id, key.submap_id)
    if record is None:
        raise NotFound(f"there is no submap {key.name!r}"[:300])
    return record


def require_job(uow: UnitOfWork, tenant: TenantId, operation_id: str) -> JobRecord:
    """The job behind an operation. Raises NotFound."""
    record = uow.jobs.get(tenant, operation_id)
    if record is None:
        raise NotFound(f"there is no operation {operation_id!r}"[:200])
    return record
