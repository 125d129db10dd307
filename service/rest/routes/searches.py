"""`/v1/maps/{map}/submaps:search` and `/v1/maps/{map}:localize`."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
from fastapi import APIRouter, Response
from fastapi.routing import APIRoute
from fastapi.security import SecurityScopes
from starlette.requests import Request

from revisit.api.calls import CALLS
from revisit.core.errors import BadField
from revisit.service.calls import search
from revisit.service.calls.search import search_fields
from revisit.service.domain.callers import current_tenant
from revisit.service.domain.identity import TenantId
from revisit.service.features.index.answers import SearchResult
from revisit.service.features.ingest.clouds import EncodedCloud
from revisit.service.features.waiting.freshness import Freshness
from revisit.service.rest.access import admitted, scopes_of, served
from revisit.service.rest.answers import answer, answers
from revisit.service.rest.bodies import (
    CLOUD_BODY,
    CLOUD_CONTENT,
    cloud_body,
    media_type,
    read_json,
)
from revisit.service.rest.parameters import (
    PATH_ID_CHARACTERS,
    Cases,
    Cloud,
    Tenant,
)
from revisit.service.rest.request_form import form_of
from revisit.service.rest.schemas import SearchRequest
from revisit.service.use_cases import UseCases
from revisit.service.wire import names
from revisit.v1.loop_closure_pb2 import LocalizeResponse as LocalizeAnswer
from revisit.v1.loop_closure_pb2 import SearchSubmapsResponse as SearchAnswer


class _SearchRoute(APIRoute):
    """A search by JSON is answered without the parameters that a search by cloud has in its query string.

    FastAPI would make them from defaults for each call, which takes as long as the search in the index.
    """

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """The handler of this route."""
        by_parameters = super().get_route_handler()
        if not self.path.endswith("/submaps:search"):
            return by_parameters
        scopes = SecurityScopes(scopes_of(self))

        async def answer_search(request: Request) -> Response:
            map_id = request.path_params["map_id"]
            # Anything else is FastAPI's to judge.
            plain = media_type(request) == "application/json" and not request.scope["query_string"]
            if not plain or len(map_id) > PATH_ID_CHARACTERS:
                return await by_parameters(request)
            await admitted(request, scopes)
            return await _answer_by_json(request, request.app.state.use_cases, current_tenant(), map_id)

        return answer_search


router = APIRouter(route_class=_SearchRoute)

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


_BY_CLOUD = form_of(CALLS["SearchSubmaps"], frozenset({"submap", "place_descriptor", "cloud", "leave_distance_m"}))
_LOCALIZE = form_of(CALLS["Localize"], frozenset({"cloud"}))


@router.api_route(**served(CALLS["SearchSubmaps"]), **answers(SearchAnswer), openapi_extra=_SEARCH_BODY)
@_BY_CLOUD.asked_by(request=Request, cases=Cases, tenant=Tenant)
async def search_submaps(request: Request, cases: UseCases, tenant: TenantId, **values: Any) -> Response:
    """The submaps most like a submap, a descriptor or a cloud."""
    asked: Any = _BY_CLOUD.message(values, None)
    if media_type(request) == "application/json":
        return await _answer_by_json(request, cases, tenant, values["map_id"])
    found: Any = await search.search_submaps(cases, tenant, asked, await cloud_body(request))
    return answer(SearchAnswer, found)


@router.api_route(**served(CALLS["Localize"]), **answers(LocalizeAnswer), openapi_extra=CLOUD_BODY)
@_LOCALIZE.asked_by(cloud=Cloud, cases=Cases, tenant=Tenant)
async def localize(cloud: EncodedCloud, cases: UseCases, tenant: TenantId, **values: Any) -> Response:
    """Where in the map was this cloud taken? No match is an answer, not an error."""
    asked: Any = _LOCALIZE.message(values, None)
    found: Any = await search.localize(cases, tenant, asked, cloud)
    return answer(LocalizeAnswer, found)


async def _answer_by_json(request: Request, cases: UseCases, tenant: TenantId, map_id: str) -> Response:
    body = await read_json(request, SearchRequest)
    return answer(SearchAnswer, search_fields(await _search_by_json(cases, tenant, map_id, body)))


async def _search_by_json(cases: UseCases, tenant: TenantId, map_id: str, body: SearchRequest) -> SearchResult:
    if (body.submap is None) == (body.descriptor is None):
        raise BadField("give either submap or descriptor", field="submap")
    fresh = Freshness(body.min_seq, body.min_seq_timeout_s)
    if body.submap is not None:
        key = names.submap_key_in(f"maps/{map_id}", body.submap, "submap")
        return await cases.searches.by_submap(tenant, key, body.criteria(), fresh)
    if body.model_version is None:
        raise BadField("a descriptor needs its model_version", field="model_version")
    vector = np.asarray(body.descriptor, dtype=np.float32)
    return await cases.searches.by_descriptor(tenant, map_id, vector, body.model_version, body.criteria(), fresh)
