"""`/v1/maps/{map}:optimise`, `:revert`, `:merge`, `/merges`, `/versions` and `/sessions/{session}:correction`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Response

from revisit.service.application.access.callers import Scope
from revisit.service.application.mapping.merges import MergeMap
from revisit.service.rest.access import allows
from revisit.service.rest.answers import (
    Correction,
    MapMerge,
    MapMergePage,
    MapVersion,
    MapVersionPage,
    Operation,
    SubmapPosePage,
    answer,
    answers,
)
from revisit.service.rest.bodies import describe_json, json_body
from revisit.service.rest.parameters import Cases, Id, Paging, SessionOf, Tenant, pose
from revisit.service.rest.schemas import MergeMapRequest, RevertMapRequest
from revisit.service.wire import names
from revisit.service.wire.answers import (
    of_correction,
    of_map_merge,
    of_map_version,
    of_operation,
    of_page,
    of_submap_pose,
)

router = APIRouter(prefix="/v1/maps/{map_id}", tags=["mapping"])


@router.post(":optimise", **answers(Operation, 202), dependencies=[allows(Scope.INGEST, Scope.ADMIN)])
async def optimise_map(map_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Optimise the pose graph of a map: an operation whose end is a new version. One that waits already is answered."""
    posted = await cases.map_versions.optimise(tenant, map_id)
    return answer(Operation, of_operation(posted.operation), 202, replay=posted.replay)


@router.post(
    ":revert",
    **answers(MapVersion),
    openapi_extra=describe_json(RevertMapRequest),
    dependencies=[allows(Scope.ADMIN)],
)
async def revert_map(
    map_id: Id, body: Annotated[RevertMapRequest, json_body(RevertMapRequest)], cases: Cases, tenant: Tenant
) -> Response:
    """Bring back the poses of an earlier version, bit for bit, as a new version."""
    return answer(MapVersion, of_map_version(await cases.map_versions.revert(tenant, map_id, body.version)))


@router.post(
    ":merge",
    **answers(Operation, 202),
    openapi_extra=describe_json(MergeMapRequest),
    dependencies=[allows(Scope.ADMIN)],
)
async def merge_map(
    map_id: Id, body: Annotated[MergeMapRequest, json_body(MergeMapRequest)], cases: Cases, tenant: Tenant
) -> Response:
    """Merge another map, or one session of it, into a map: an operation whose end is a new version, or the reason
    against.
    """
    near = None if body.T_map_source is None else pose(body.T_map_source, "T_map_source")
    order = MergeMap(map_id, *names.merge_source(body.source), body.validate_only, near, body.radius_m)
    posted = await cases.map_merges.merge(tenant, order)
    return answer(Operation, of_operation(posted.operation), 202, replay=posted.replay)


@router.get("/merges", **answers(MapMergePage), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_map_merges(map_id: Id, cases: Cases, tenant: Tenant, paging: Paging) -> Response:
    """List the merges into a map, oldest first, those taken back too."""
    page = await cases.map_merges.list(tenant, map_id, paging)
    return answer(MapMergePage, of_page("map_merges", page, of_map_merge))


@router.get("/merges/{merge_id}", **answers(MapMerge), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def get_map_merge(map_id: Id, merge_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Get a merge into a map."""
    return answer(MapMerge, of_map_merge(await cases.map_merges.get(tenant, map_id, merge_id)))


@router.post("/merges/{merge_id}:revert", **answers(MapMerge), dependencies=[allows(Scope.ADMIN)])
async def revert_map_merge(map_id: Id, merge_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Take the last merge back: its copies are deleted, the poses from before it come back bit for bit."""
    return answer(MapMerge, of_map_merge(await cases.map_merges.revert(tenant, map_id, merge_id)))


@router.get("/versions", **answers(MapVersionPage), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_map_versions(map_id: Id, cases: Cases, tenant: Tenant, paging: Paging) -> Response:
    """List the versions of a map that are kept, oldest first."""
    page = await cases.map_versions.list(tenant, map_id, paging)
    return answer(MapVersionPage, of_page("map_versions", page, of_map_version))


@router.get("/versions/{version_id}", **answers(MapVersion), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def get_map_version(map_id: Id, version_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Get a version of a map."""
    version = names.version_number(version_id)
    return answer(MapVersion, of_map_version(await cases.map_versions.get(tenant, map_id, version)))


@router.get("/versions/{version_id}/poses", **answers(SubmapPosePage), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_submap_poses(map_id: Id, version_id: Id, cases: Cases, tenant: Tenant, paging: Paging) -> Response:
    """The poses of the submaps in a version of a map, by session and in the order of their drive."""
    page = await cases.map_versions.poses(tenant, map_id, names.version_number(version_id), paging)
    return answer(SubmapPosePage, of_page("submap_poses", page, of_submap_pose))


@router.get(
    "/sessions/{session_id}:correction", **answers(Correction), dependencies=[allows(Scope.INGEST, Scope.QUERY)]
)
async def get_correction(key: SessionOf, cases: Cases, tenant: Tenant) -> Response:
    """Where the odometry frame of a session lies in the map; NOT_READY where no version of the map has the session."""
    return answer(Correction, of_correction(await cases.corrections.get(tenant, key)))
