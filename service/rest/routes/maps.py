"""`/v1/maps`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Response

from revisit.service.application.access.callers import Scope
from revisit.service.rest.access import allows
from revisit.service.rest.bodies import describe_json, json_body
from revisit.service.rest.parameters import Cases, Id, Paging, Tenant, mark_replay
from revisit.service.rest.schemas import CreateMapRequest, Map, MapPage

router = APIRouter(prefix="/v1/maps", tags=["maps"])


@router.post("", status_code=201, openapi_extra=describe_json(CreateMapRequest), dependencies=[allows(Scope.INGEST)])
async def create_map(
    body: Annotated[CreateMapRequest, json_body(CreateMapRequest)], cases: Cases, tenant: Tenant, response: Response
) -> Map:
    """Create a map. The same id with the same content answers again; with other content it is a conflict."""
    created = await cases.maps.create(tenant, body.command())
    mark_replay(response, created.replay)
    return Map.of(created.map)


@router.get("", dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_maps(cases: Cases, tenant: Tenant, paging: Paging) -> MapPage:
    """List the maps, oldest first."""
    page = await cases.maps.list(tenant, paging)
    return MapPage(maps=[Map.of(view) for view in page.items], next_page_token=page.next_token)


@router.get("/{map_id}", dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def get_map(map_id: Id, cases: Cases, tenant: Tenant) -> Map:
    """Get a map."""
    return Map.of(await cases.maps.get(tenant, map_id))


@router.delete("/{map_id}", status_code=204, dependencies=[allows(Scope.ADMIN)])
async def delete_map(map_id: Id, cases: Cases, tenant: Tenant) -> None:
    """Delete a map with everything in it."""
    await cases.maps.delete(tenant, map_id)
