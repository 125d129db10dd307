"""Searches: which submaps look like this one, and where in the map was this cloud taken?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from core.se3 import Matrix4
from service.application.clouds import CloudInput
from service.application.identity import SubmapKey, TenantId


@dataclass(frozen=True)
class SearchCriteria:
    """What a hit must satisfy. All optional but `k` (1 to 100).

    `min_index_gap` applies to submaps of the query's own session; `prior_position_m` with `radius_m` keeps hits whose
    position (in their session's odometry frame) is near.
    """

    k: int = 20
    min_similarity: float | None = None
    exclude_session: str | None = None
    only_session: str | None = None
    min_index_gap: int | None = None
    prior_position_m: tuple[float, float, float] | None = None
    radius_m: float | None = None


@dataclass(frozen=True)
class SearchHit:
    """A submap and its cosine similarity to the query."""

    submap: SubmapKey
    similarity: float
    position_m: tuple[float, float, float]


@dataclass(frozen=True)
class SearchResult:
    """Hits, most similar first (ties: older submap first); `searched` is how many submaps the map's index held."""

    hits: tuple[SearchHit, ...]
    searched: int


@dataclass(frozen=True)
class LocalizeQuery:
    """Where was this cloud taken? `prior_position_m` and `radius_m` (metres) narrow the search."""

    map_id: str
    cloud: CloudInput
    prior_position_m: tuple[float, float, float] | None = None
    radius_m: float | None = None
    candidates: int = 10


@dataclass(frozen=True)
class LocalizedCandidate:
    """One submap that was compared: accepted with a transform, or rejected for a reason."""

    submap: SubmapKey
    accepted: bool
    reason: str | None
    similarity: float
    score: float
    T_match_query: Matrix4 | None
    evidence: dict[str, Any]


@dataclass(frozen=True)
class Localization:
    """The best verified candidate, if any, and all that were compared.

    `T_map_query` (4, 4) is the cloud's pose in the odometry frame of the best candidate's session.
    """

    best: LocalizedCandidate | None
    T_map_query: Matrix4 | None
    candidates: tuple[LocalizedCandidate, ...]


class Searches(Protocol):
    """Search by submap, by descriptor or by cloud; localise."""

    async def by_submap(self, tenant: TenantId, key: SubmapKey, criteria: SearchCriteria) -> SearchResult:
        """The submaps most like a described one, which is never its own hit. Raises NotFound, NotReady, BadField."""
        ...

    async def by_descriptor(
        self, tenant: TenantId, map_id: str, vector: NDArray[np.float32], model_version: str, criteria: SearchCriteria
    ) -> SearchResult:
        """The submaps nearest to a descriptor (d,). Raises NotFound, BadField, DescriptorModelMismatch."""
        ...

    async def by_cloud(
        self, tenant: TenantId, map_id: str, cloud: CloudInput, criteria: SearchCriteria, timeout_s: float = 30.0
    ) -> SearchResult:
        """Describe a cloud in a worker, store no submap, search. Raises DeadlineExceeded, WorkersBusy, NotFound, ..."""
        ...

    async def localize(self, tenant: TenantId, query: LocalizeQuery, timeout_s: float = 30.0) -> Localization:
        """Describe a cloud in a worker, search, verify. No match is a result. Raises as `by_cloud`."""
        ...
