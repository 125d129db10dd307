"""Bounds, defaults and required fields of requests, which their descriptors lack.

By the name of a field, which means the same in every message.
"""

from __future__ import annotations

from typing import Any

from revisit.service.calls.operations import DEFAULT_OPERATION_WAIT_S
from revisit.service.domain import limits
from revisit.service.domain.limits import Range
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.index.answers import SearchCriteria
from revisit.service.features.resources.paging import PageRequest
from revisit.service.features.search.calls import LocalizeQuery
from revisit.service.features.tiles.calls import MapQuestion
from revisit.service.features.waiting.freshness import DEFAULT_WAIT_S
from revisit.service.rest.schemas import DISPLAY_NAME, ID, PROFILE, STOREY, TAG

POSE_CHARACTERS, POINT_CHARACTERS = 400, 200

BOUNDS: dict[str, Range] = {
    "tau_m": limits.TAU_M,
    "stride_m": limits.STRIDE_M,
    "leave_distance_m": limits.LEAVE_DISTANCE_M,
    "scene_scale": limits.SCENE_SCALE,
    "candidates": limits.LOOP_CANDIDATES,
    "min_score": limits.MIN_SCORE,
    "min_overlap": limits.MIN_OVERLAP,
    "max_seen_through": limits.MAX_SEEN_THROUGH,
    "k": limits.K,
    "min_similarity": limits.MIN_SIMILARITY,
    "scans_after_hours": limits.SCANS_AFTER_HOURS,
    "best_submaps": limits.BEST_SUBMAPS,
    "session_days": limits.RETENTION_DAYS,
    "dropped_session_days": limits.RETENTION_DAYS,
    "rejected_days": limits.RETENTION_DAYS,
    "retired_days": limits.RETENTION_DAYS,
    "version": limits.MAP_VERSION,
    "radius_m": limits.RADIUS_M,
    "within_m": limits.MAP_RADIUS_M,
    "limit": limits.MAP_POINTS,
    "heading_rad": limits.HEADING_RAD,
    "heading_sigma_rad": limits.HEADING_SIGMA_RAD,
    **limits.GEODETIC,
    "pixel_x": limits.PLAN_PIXEL,
    "pixel_y": limits.PLAN_PIXEL,
    "x_m": limits.PLAN_COORDINATE_M,
    "y_m": limits.PLAN_COORDINATE_M,
    "page_size": limits.PAGE_SIZE,
    "strengths_dbm": limits.STRENGTH_DBM,
    "stamp_ns": limits.STAMP_NS,
    "as_of_ns": limits.STAMP_NS,
    "after_ns": limits.STAMP_NS,
    "until_ns": limits.STAMP_NS,
    "min_seq": limits.MIN_SEQ,
    "min_seq_timeout_s": limits.WAIT_S,
    "timeout_s": limits.WAIT_S,
}
"""Of numbers; of a list, those of each."""

TEXTS: dict[str, dict[str, Any]] = {
    "map_id": ID,
    "robot_id": ID,
    "session_id": ID,
    "anchor_id": ID,
    "plan_id": ID,
    "webhook_id": ID,
    "robot": ID,
    "map": ID,
    "display_name": DISPLAY_NAME,
    "storey": STOREY,
    "tag": TAG,
    "profile": PROFILE,
    "url": {"max_length": limits.URL_CHARACTERS},
    "page_token": {"max_length": limits.PAGE_TOKEN_CHARACTERS},
    "reason": {"max_length": limits.REASON_CHARACTERS},
    "note": {"max_length": limits.NOTE_CHARACTERS},
    "map_descriptor": {"max_length": limits.NOTE_CHARACTERS},
    "source": {"max_length": limits.RESOURCE_NAME_CHARACTERS},
    "query": {"max_length": limits.RESOURCE_NAME_CHARACTERS},
    "match": {"max_length": limits.RESOURCE_NAME_CHARACTERS},
    "frame": {"max_length": limits.ID_CHARACTERS},
    "session": {"max_length": limits.ID_CHARACTERS},
    "exclude_session": {"max_length": limits.ID_CHARACTERS},
    "only_session": {"max_length": limits.ID_CHARACTERS},
}
"""Of strings."""

DEFAULTS: dict[str, Any] = {
    "policy": None,
    "geodetic": None,
    "profile": CreateMap.profile,
    "scene_scale": 1.0,
    "k": SearchCriteria().k,
    "LocalizeRequest.candidates": LocalizeQuery.candidates,
    "page_size": PageRequest().size,
    "limit": MapQuestion.limit,
    "min_seq_timeout_s": DEFAULT_WAIT_S,
    "timeout_s": DEFAULT_OPERATION_WAIT_S,
    "view": "BASIC",
    "storey": None,
    "reason": None,
}
"""Where they are not those of protobuf; by message and field where a name alone is not enough."""

REQUIRED = frozenset({
    "map_id", "robot_id", "session_id", "webhook_id", "url", "version", "source", "query", "match", "points_m",
    "centre_m", "within_m", "anchors", "anchor_id", "readings", "access_points", "strengths_dbm",
    "plan_id", "pins",
})  # fmt: skip
