"""`/v1/maps/{map}/versions/{version}:publish` and `/v1/maps/{map}/files`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Response

from revisit.service.application.access.callers import Scope
from revisit.service.rest.access import allows
from revisit.service.rest.answers import MapFile, MapFilePage, Operation, answer, answers
from revisit.service.rest.bodies import ANY_BINARY, describe_json, json_body
from revisit.service.rest.parameters import Cases, Id, Paging, Tenant
from revisit.service.rest.ranges import MAP_FILE, FileInRanges
from revisit.service.rest.schemas import PublishMapFileRequest
from revisit.service.wire import names
from revisit.service.wire.answers import of_operation, of_page
from revisit.service.wire.map_parts import of_map_file

router = APIRouter(prefix="/v1/maps/{map_id}", tags=["map files"])


@router.post(
    "/versions/{version_id}:publish",
    **answers(Operation, 202),
    openapi_extra=describe_json(PublishMapFileRequest),
    dependencies=[allows(Scope.ADMIN)],
)
async def publish_map_file(
    map_id: Id,
    version_id: Id,
    body: Annotated[PublishMapFileRequest, json_body(PublishMapFileRequest)],
    cases: Cases,
    tenant: Tenant,
) -> Response:
    """Make a file of a version: an operation, the end of which names its hash."""
    version = names.version_number(version_id)
    posted = await cases.map_files.publish(tenant, map_id, version, body.map_descriptor)
    return answer(Operation, of_operation(posted.operation), 202, replay=posted.replay)


@router.get("/files", **answers(MapFilePage), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_map_files(map_id: Id, cases: Cases, tenant: Tenant, paging: Paging) -> Response:
    """List the files of a map, oldest first."""
    page = await cases.map_files.list(tenant, map_id, paging)
    return answer(MapFilePage, of_page("map_files", page, of_map_file))


@router.get(
    "/files/{version_id}:download",
    response_class=Response,
    responses={
        200: {"content": {MAP_FILE: ANY_BINARY}, "description": "The file"},
        206: {"content": {MAP_FILE: ANY_BINARY}, "description": "The range that was asked for"},
        304: {"description": "The file is the one that `If-None-Match` names"},
        416: {"description": "The range begins behind the end of the file"},
    },
    dependencies=[allows(Scope.INGEST, Scope.QUERY)],
)
async def download_map_file(
    map_id: Id,
    version_id: Id,
    cases: Cases,
    tenant: Tenant,
    byte_range: Annotated[str | None, Header(alias="Range", max_length=100)] = None,
    if_range: Annotated[str | None, Header(alias="If-Range", max_length=100)] = None,
    if_none_match: Annotated[str | None, Header(alias="If-None-Match", max_length=1000)] = None,
) -> Response:
    """Download a file, or one range of its bytes; its ETag is its hash."""
    file = await cases.map_files.open(tenant, map_id, names.version_number(version_id))
    return FileInRanges(cases.budget, tenant, file, byte_range, if_range, if_none_match)


@router.post("/files/{version_id}:enable", **answers(MapFile), dependencies=[allows(Scope.ADMIN)])
async def enable_map_file(map_id: Id, version_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Say that robots are to use this version: its file becomes ENABLED, the one that was becomes DISABLED."""
    return answer(MapFile, of_map_file(await cases.map_files.enable(tenant, map_id, names.version_number(version_id))))


@router.get("/files/{version_id}", **answers(MapFile), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def get_map_file(map_id: Id, version_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Get the description of a file."""
    return answer(MapFile, of_map_file(await cases.map_files.get(tenant, map_id, names.version_number(version_id))))


@router.delete("/files/{version_id}", status_code=204, dependencies=[allows(Scope.ADMIN)])
async def delete_map_file(map_id: Id, version_id: Id, cases: Cases, tenant: Tenant) -> None:
    """Delete a file; the version stays."""
    await cases.map_files.delete(tenant, map_id, names.version_number(version_id))
