"""Loop closures: pairs of submaps that look alike, with the verdict of geometric verification and its evidence."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

from core.se3 import Matrix4
from service.application.identity import SubmapKey, TenantId
from service.application.paging import Page, PageRequest


class LoopState(StrEnum):
    """The verdict."""

    ACCEPTED = "ACCEPTED"
    REJECTED = "REJECTED"


@dataclass(frozen=True)
class LoopClosureView:
    """A loop closure as clients see it.

    `T_match_query` (4, 4) maps points of the query submap's frame into the match submap's frame, None where the
    candidate was rejected before an alignment existed; `covariance` (6, 6) row-major of it; `reason` says which gate
    rejected it; `evidence` holds similarity, inliers, overlap, residual, thresholds and model versions as JSON.
    `number` grows with every closure of the service: it orders them and resumes a watch.
    """

    loop_id: str
    number: int
    map_id: str
    query: SubmapKey
    match: SubmapKey
    state: LoopState
    reason: str | None
    similarity: float
    score: float
    T_match_query: Matrix4 | None
    evidence: dict[str, Any]
    created_at_ns: int

    @property
    def name(self) -> str:
        """The resource name."""
        return f"maps/{self.map_id}/loopClosures/{self.loop_id}"


class Loops(Protocol):
    """Get, list and watch loop closures."""

    async def get(self, tenant: TenantId, map_id: str, loop_id: str) -> LoopClosureView:
        """Raises NotFound."""
        ...

    async def list(
        self,
        tenant: TenantId,
        map_id: str,
        page: PageRequest,
        state: LoopState | None = None,
        session_id: str | None = None,
    ) -> Page[LoopClosureView]:
        """The closures of a map, oldest first; `session_id` keeps those whose query submap is of that session.

        Raises NotFound for the map.
        """
        ...

    def watch(
        self, tenant: TenantId, map_id: str, after: int = 0, session_id: str | None = None
    ) -> AsyncIterator[LoopClosureView]:
        """The accepted closures with a number above `after`, those to come too, until the caller stops.

        Raises NotFound for the map; Draining when the service stops.
        """
        ...
