"""Searches for places."""

from __future__ import annotations

from revisit.core.errors import BadField
from revisit.service.domain.identity import TenantId
from revisit.service.features.index.answers import (
    Localization,
    LocalizedCandidate,
    SearchCriteria,
    SearchHit,
    SearchResult,
)
from revisit.service.features.ingest.clouds import EncodedCloud
from revisit.service.features.search.calls import LocalizeQuery
from revisit.service.use_cases import UseCases
from revisit.service.wire import names, requests
from revisit.service.wire.fields import Fields, fields_in_map, fields_of
from revisit.service.wire.rendering import Answer
from revisit.v1 import loop_closure_pb2 as pb


async def search_submaps(
    cases: UseCases, tenant: TenantId, request: pb.SearchSubmapsRequest, body: EncodedCloud | None = None
) -> Answer:
    """The submaps most like a submap, a descriptor or a cloud, which may be the `body` of the request."""
    return search_fields(await _search(cases, tenant, request, body))


async def _search(
    cases: UseCases, tenant: TenantId, request: pb.SearchSubmapsRequest, body: EncodedCloud | None
) -> SearchResult:
    map_id, criteria = names.map_id(request.parent, "parent"), _criteria(request)
    fresh = requests.freshness(request)
    match request.WhichOneof("query"):
        case "submap":
            key = names.submap_key_in(request.parent, request.submap, "submap")
            return await cases.searches.by_submap(tenant, key, criteria, fresh)
        case "place_descriptor":
            vector, version = requests.vector(request.place_descriptor), request.place_descriptor.model_version
            return await cases.searches.by_descriptor(tenant, map_id, vector, version, criteria, fresh)
        case "cloud":
            body = requests.cloud(request.cloud)
    if body is None:
        raise BadField("give a submap, a descriptor or a cloud", field="query")
    level = requests.optional_pose(request, "t_level_query")
    return await cases.searches.by_cloud(tenant, map_id, body, criteria, fresh, T_level_query=level)


async def localize(
    cases: UseCases, tenant: TenantId, request: pb.LocalizeRequest, body: EncodedCloud | None = None
) -> Answer:
    """Where in the map the cloud was taken, which may be the `body` of the request, if the place is known."""
    query = LocalizeQuery(
        map_id=names.map_id(request.parent, "parent"),
        cloud=body or requests.cloud(request.cloud),
        prior_position_m=requests.position(request),
        radius_m=requests.optional(request, "radius_m"),
        exclude_session=names.session_id_in(request.parent, request.exclude_session, "exclude_session"),
        only_session=names.session_id_in(request.parent, request.only_session, "only_session"),
        T_level_query=requests.optional_pose(request, "t_level_query"),
        storey=request.storey or None,
        **requests.present(request, "candidates"),
    )
    return localization_fields(await cases.searches.localize(tenant, query, requests.freshness(request)))


def _criteria(request: pb.SearchSubmapsRequest) -> SearchCriteria:
    return SearchCriteria(
        **requests.present(request, "k"),
        min_similarity=requests.optional(request, "min_similarity"),
        exclude_session=names.session_id_in(request.parent, request.exclude_session, "exclude_session"),
        only_session=names.session_id_in(request.parent, request.only_session, "only_session"),
        leave_distance_m=requests.optional(request, "leave_distance_m"),
        prior_position_m=requests.position(request),
        radius_m=requests.optional(request, "radius_m"),
        storey=request.storey or None,
    )


def search_fields(result: SearchResult) -> Fields:
    """The fields of a SearchSubmapsResponse."""
    return fields_of(pb.SearchSubmapsResponse, result, hits=[_hit(hit) for hit in result.hits])


def localization_fields(found: Localization) -> Fields:
    """The fields of a LocalizeResponse."""
    return fields_of(
        pb.LocalizeResponse,
        found,
        best=None if found.best is None else _candidate(found.best),
        session=None if found.session is None else found.session.name,
        candidates=[_candidate(candidate) for candidate in found.candidates],
        **fields_in_map("t_map_query", found.in_map),
    )


def _hit(hit: SearchHit) -> Fields:
    return fields_of(pb.SearchHit, hit, submap=hit.submap.name, **fields_in_map("t_map_submap", hit.in_map))


def _candidate(candidate: LocalizedCandidate) -> Fields:
    return fields_of(pb.LocalizedCandidate, candidate, submap=candidate.submap.name)
