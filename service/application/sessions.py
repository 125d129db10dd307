"""Sessions: one drive of one robot, in one odometry frame."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from service.application.identity import SessionKey, TenantId
from service.application.paging import Page, PageRequest


class SessionState(StrEnum):
    """Whether a session still takes data."""

    ACTIVE = "ACTIVE"
    FINISHED = "FINISHED"


@dataclass(frozen=True)
class CreateSession:
    """A new session in a map; `robot_id` is None or an existing robot."""

    map_id: str
    session_id: str
    robot_id: str | None = None


@dataclass(frozen=True)
class SessionView:
    """A session as clients see it. `committed_seq` is the last scan stored durably, 0 for none."""

    key: SessionKey
    robot_id: str | None
    state: SessionState
    committed_seq: int
    travelled_m: float
    submap_count: int
    created_at_ns: int
    finished_at_ns: int | None


@dataclass(frozen=True)
class CreatedSession:
    """The session, and whether an earlier identical request had created it."""

    session: SessionView
    replay: bool


class Sessions(Protocol):
    """Create, get, list and finish sessions."""

    async def create(self, tenant: TenantId, command: CreateSession) -> CreatedSession:
        """Create a session. Raises BadField; NotFound for the map or the robot; AlreadyExists for other content."""
        ...

    async def get(self, tenant: TenantId, key: SessionKey) -> SessionView:
        """Raises NotFound."""
        ...

    async def list(self, tenant: TenantId, map_id: str, page: PageRequest) -> Page[SessionView]:
        """The sessions of a map, oldest first. Raises NotFound for the map."""
        ...

    async def finish(self, tenant: TenantId, key: SessionKey) -> SessionView:
        """Close the session; the scans of its last, shorter window become a submap. Again: no effect. Raises NotFound."""
        ...
