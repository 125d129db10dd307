"""Finding a session and asking whether it still takes data."""

from __future__ import annotations

from enum import StrEnum

from revisit.service.application.contract.errors import NotFound, SessionFinished
from revisit.service.application.contract.identity import SessionKey, TenantId
from revisit.service.application.contract.ports import UnitOfWork
from revisit.service.application.contract.records import SessionRecord


class SessionState(StrEnum):
    """Whether a session still takes data."""

    ACTIVE = "ACTIVE"
    FINISHED = "FINISHED"


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
