"""`/v1/maps/{map}:optimise`, `:revert`, `/versions` and `/sessions/{session}:correction`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Response

from revisit.service.application.access.callers import Scope
from revisit.service.rest.access import allows
from revisit.service.rest.answers import (
    Correction,
    MapVersion,
    MapVersionPage,
    Operation,
    SubmapPosePage,
    answer,
    answers,
)
from revisit.service.rest.bodies import describe_json, json_body
from revisit.service.rest.parameters import Cases, Id, Paging, SessionOf, Tenant
from revisit.service.rest.schemas import RevertMapRequest
from revisit.service.wire import names
from revisit.service.wire.answers import of_correction, of_map_version, of_operation, of_page, of_submap_pose

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
