"""`/v1/maps`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Response

from revisit.service.application.access.callers import Scope
from revisit.service.rest.access import allows
from revisit.service.rest.answers import Map, MapPage, answer, answers, page_answer
from revisit.service.rest.bodies import describe_json, json_body
from revisit.service.rest.parameters import Cases, Id, Paging, Tenant
from revisit.service.rest.schemas import CreateMapRequest
from revisit.service.wire.answers import of_map

router = APIRouter(prefix="/v1/maps", tags=["maps"])


@router.post(
    "", **answers(Map, 201), openapi_extra=describe_json(CreateMapRequest), dependencies=[allows(Scope.INGEST)]
)
async def create_map(
    body: Annotated[CreateMapRequest, json_body(CreateMapRequest)], cases: Cases, tenant: Tenant
) -> Response:
    """Create a map. The same id with the same content answers again; with other content it is a conflict."""
    created = await cases.maps.create(tenant, body.command())
    return answer(Map, of_map(created.map), 201, replay=created.replay)


@router.get("", **answers(MapPage), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_maps(cases: Cases, tenant: Tenant, paging: Paging) -> Response:
    """List the maps, oldest first."""
    return await page_answer(MapPage, "maps", await cases.maps.list(tenant, paging), of_map)


@router.get("/{map_id}", **answers(Map), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def get_map(map_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Get a map."""
    return answer(Map, of_map(await cases.maps.get(tenant, map_id)))


@router.delete("/{map_id}", status_code=204, dependencies=[allows(Scope.ADMIN)])
async def delete_map(map_id: Id, cases: Cases, tenant: Tenant) -> None:
    """Delete a map with everything in it."""
    await cases.maps.delete(tenant, map_id)
