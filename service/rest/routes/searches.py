"""`/v1/maps/{map}/submaps:search` and `/v1/maps/{map}:localize`."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends, Query
from starlette.requests import Request

from revisit.core.errors import BadField
from revisit.service.application import UseCases
from revisit.service.application.access.callers import Scope
from revisit.service.application.contract.identity import SubmapKey, TenantId
from revisit.service.application.query.searches import Freshness, LocalizeQuery, SearchCriteria, SearchResult
from revisit.service.rest.access import allows
from revisit.service.rest.bodies import (
    CLOUD_BODY,
    CLOUD_CONTENT,
    cloud_body,
    json_bytes,
    limits_of,
    media_type,
    parse_json,
)
from revisit.service.rest.parameters import (
    Cases,
    Cloud,
    Fresh,
    Id,
    Prior,
    RadiusM,
    Tenant,
    criteria_of_body,
    criteria_of_query,
)
from revisit.service.rest.schemas import LocalizeAnswer, SearchAnswer, SearchRequest

router = APIRouter(prefix="/v1/maps", tags=["searches"])

_SEARCH_BODY = {
    "requestBody": {
        "required": True,
        "description": "JSON to search by submap or by descriptor, else a point cloud (criteria in the query string).",
        "content": {
            "application/json": {"schema": SearchRequest.model_json_schema()},
            **CLOUD_CONTENT,
        },
    }
}


@router.post("/{map_id}/submaps:search", openapi_extra=_SEARCH_BODY, dependencies=[allows(Scope.QUERY)])
async def search_submaps(
    map_id: Id,
    request: Request,
    criteria: Annotated[SearchCriteria, Depends(criteria_of_query)],
    fresh: Fresh,
    cases: Cases,
    tenant: Tenant,
) -> SearchAnswer:
    """The submaps most like a submap, a descriptor or a cloud."""
    if media_type(request) == "application/json":
        body = parse_json(await json_bytes(request), SearchRequest, limits_of(request))
        return SearchAnswer.of(await _search_by_json(cases, tenant, map_id, body))
    cloud = await cloud_body(request)
    return SearchAnswer.of(await cases.searches.by_cloud(tenant, map_id, cloud, criteria, fresh))


@router.post("/{map_id}:localize", openapi_extra=CLOUD_BODY, dependencies=[allows(Scope.QUERY)])
async def localize(
    map_id: Id,
    cloud: Cloud,
    cases: Cases,
    tenant: Tenant,
    prior: Prior,
    fresh: Fresh,
    radius_m: RadiusM = None,
    candidates: Annotated[int, Query(ge=1, le=100)] = 10,
) -> LocalizeAnswer:
    """Where in the map was this cloud taken? No match is an answer, not an error."""
    query = LocalizeQuery(map_id, cloud, prior, radius_m, candidates)
    return LocalizeAnswer.of(await cases.searches.localize(tenant, query, fresh))


async def _search_by_json(cases: UseCases, tenant: TenantId, map_id: str, body: SearchRequest) -> SearchResult:
    if (body.submap is None) == (body.descriptor is None):
        raise BadField("give either submap or descriptor", field="submap")
    fresh = Freshness(body.min_seq, body.min_seq_timeout_s)
    if body.submap is not None:
        return await cases.searches.by_submap(tenant, _submap_of(map_id, body.submap), criteria_of_body(body), fresh)
    if body.model_version is None:
        raise BadField("a descriptor needs its model_version", field="model_version")
    vector = np.asarray(body.descriptor, dtype=np.float32)
    criteria = criteria_of_body(body)
    return await cases.searches.by_descriptor(tenant, map_id, vector, body.model_version, criteria, fresh)


def _submap_of(map_id: str, name: str) -> SubmapKey:
    match name.split("/"):
        case ["maps", of_map, "sessions", session_id, "submaps", submap_id] if of_map == map_id:
            return SubmapKey(map_id, session_id, submap_id)
    raise BadField(f"submap must be maps/{map_id}/sessions/SESSION/submaps/SUBMAP", field="submap")
