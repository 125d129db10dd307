"""Criteria and answers of a search, and both as JSON: a worker writes the answer into the operation."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any

from revisit.core.errors import BadField
from revisit.core.geometry.se3 import Matrix4, pose_matrix, pose_row
from revisit.service.domain import limits
from revisit.service.domain.identity import SessionKey, SubmapKey, validated_detail
from revisit.service.features.graph.map_frames import MapPose


@dataclass(frozen=True)
class SearchCriteria:
    """The conditions of a hit. All optional but `k` (1 to 100).

    `leave_distance_m` leaves out submaps of the query's own drive that it has just left (`core.acceptance.revisits`);
    `prior_position_m` with `radius_m` keeps hits that are near (in the odometry frame of `only_session`, or of the
    map's one session). `storey`: where a cloud or descriptor was taken; submaps of sessions on another one are no hits.
    A stored submap has that of its session.
    """

    k: int = 20
    min_similarity: float | None = None
    exclude_session: str | None = None
    only_session: str | None = None
    leave_distance_m: float | None = None
    prior_position_m: tuple[float, float, float] | None = None
    radius_m: float | None = None
    storey: str | None = None


@dataclass(frozen=True)
class SearchHit:
    """A submap and its cosine similarity to the query; `in_map` is T_map_submap where its session has a frame."""

    submap: SubmapKey
    similarity: float
    position_m: tuple[float, float, float]
    in_map: MapPose | None = None


@dataclass(frozen=True)
class SearchResult:
    """Hits, most similar first (ties: older submap first); `searched` is how many submaps the map's index held.

    `on_other_storeys` of them could be no hits, as their sessions are on another storey than the query.
    """

    hits: tuple[SearchHit, ...]
    searched: int
    on_other_storeys: int = 0


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

    `T_odom_query` (4, 4) maps points of the cloud into the odometry frame of `session`; `in_map` is T_map_query where
    that session has a frame. `on_other_storeys` submaps could not be compared, for their storey is another.
    """

    best: LocalizedCandidate | None
    T_odom_query: Matrix4 | None
    candidates: tuple[LocalizedCandidate, ...]
    in_map: MapPose | None = None
    on_other_storeys: int = 0

    @property
    def session(self) -> SessionKey | None:
        """The session of the best candidate."""
        return None if self.best is None else self.best.submap.session


def validated_criteria(criteria: SearchCriteria) -> SearchCriteria:
    """`criteria` if they can be searched for. Raises BadField."""
    limits.K.validated(criteria.k, "k")
    if (criteria.prior_position_m is None) != (criteria.radius_m is None):
        raise BadField("a prior position and a radius go together", field="radius_m")
    if criteria.radius_m is not None:
        limits.RADIUS_M.validated(criteria.radius_m, "radius_m")
    for coordinate in criteria.prior_position_m or ():
        limits.PRIOR_COORDINATE_M.validated(coordinate, "prior_position_m")
    if criteria.min_similarity is not None:
        limits.MIN_SIMILARITY.validated(criteria.min_similarity, "min_similarity")
    validated_detail(criteria.storey, "storey")
    if criteria.leave_distance_m is not None:
        limits.LEAVE_DISTANCE_M.validated(criteria.leave_distance_m, "leave_distance_m")
    return criteria


def criteria_to_json(criteria: SearchCriteria) -> dict[str, Any]:
    """For a job's payload."""
    return asdict(criteria)


def criteria_from_json(data: dict[str, Any]) -> SearchCriteria:
    """The inverse of `criteria_to_json`; other members, of an earlier version, are ignored."""
    prior = data["prior_position_m"]
    known = {field.name: data[field.name] for field in fields(SearchCriteria) if field.name in data}
    return SearchCriteria(**{**known, "prior_position_m": None if prior is None else tuple(prior)})


def search_result_to_json(result: SearchResult) -> dict[str, Any]:
    """For an operation's result."""
    return asdict(result)


def search_result_from_json(data: dict[str, Any]) -> SearchResult:
    """The inverse of `search_result_to_json`."""
    hits = tuple(_hit_from_json(hit) for hit in data["hits"])
    return SearchResult(hits, data["searched"], data.get("on_other_storeys", 0))


def localization_to_json(localization: Localization) -> dict[str, Any]:
    """For an operation's result; the best candidate is named by its place in the list."""
    best = localization.best
    return {
        "best": None if best is None else localization.candidates.index(best),
        "T_odom_query": None if localization.T_odom_query is None else pose_row(localization.T_odom_query),
        "candidates": [_candidate_to_json(candidate) for candidate in localization.candidates],
        "in_map": None if localization.in_map is None else asdict(localization.in_map),
        "on_other_storeys": localization.on_other_storeys,
    }


def localization_from_json(data: dict[str, Any]) -> Localization:
    """The inverse of `localization_to_json`."""
    candidates = tuple(_candidate_from_json(candidate) for candidate in data["candidates"])
    return Localization(
        best=None if data["best"] is None else candidates[data["best"]],
        T_odom_query=None if data["T_odom_query"] is None else pose_matrix(tuple(data["T_odom_query"])),
        candidates=candidates,
        in_map=_map_pose_from_json(data),
        on_other_storeys=data.get("on_other_storeys", 0),
    )


def _hit_from_json(data: dict[str, Any]) -> SearchHit:
    x, y, z = data["position_m"]
    return SearchHit(SubmapKey(**data["submap"]), data["similarity"], (x, y, z), _map_pose_from_json(data))


def _map_pose_from_json(data: dict[str, Any]) -> MapPose | None:
    pose = data.get("in_map")
    return None if pose is None else MapPose(tuple(pose["T_map"]), pose["frame"], pose["map_version"])


def _candidate_to_json(candidate: LocalizedCandidate) -> dict[str, Any]:
    pose = None if candidate.T_match_query is None else pose_row(candidate.T_match_query)
    return {
        "submap": asdict(candidate.submap),
        "accepted": candidate.accepted,
        "reason": candidate.reason,
        "similarity": candidate.similarity,
        "score": candidate.score,
        "T_match_query": pose,
        "evidence": candidate.evidence,
    }


def _candidate_from_json(data: dict[str, Any]) -> LocalizedCandidate:
    pose = data["T_match_query"]
    return LocalizedCandidate(
        submap=SubmapKey(**data["submap"]),
        accepted=data["accepted"],
        reason=data["reason"],
        similarity=data["similarity"],
        score=data["score"],
        T_match_query=None if pose is None else pose_matrix(tuple(pose)),
        evidence=data["evidence"],
    )
