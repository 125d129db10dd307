"""`/v1/robots`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Response

from revisit.service.application.access.callers import Scope
from revisit.service.rest.access import allows
from revisit.service.rest.bodies import describe_json, json_body
from revisit.service.rest.parameters import Cases, Id, Paging, Tenant, mark_replay
from revisit.service.rest.schemas import CreateRobotRequest, Robot, RobotPage

router = APIRouter(prefix="/v1/robots", tags=["robots"])


@router.post("", status_code=201, openapi_extra=describe_json(CreateRobotRequest), dependencies=[allows(Scope.INGEST)])
async def create_robot(
    body: Annotated[CreateRobotRequest, json_body(CreateRobotRequest)],
    cases: Cases,
    tenant: Tenant,
    response: Response,
) -> Robot:
    """Create a robot; idempotent like a map."""
    created = await cases.robots.create(tenant, body.command())
    mark_replay(response, created.replay)
    return Robot.of(created.robot)


@router.get("", dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_robots(cases: Cases, tenant: Tenant, paging: Paging) -> RobotPage:
    """List the robots, oldest first."""
    page = await cases.robots.list(tenant, paging)
    return RobotPage(robots=[Robot.of(view) for view in page.items], next_page_token=page.next_token)


@router.get("/{robot_id}", dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def get_robot(robot_id: Id, cases: Cases, tenant: Tenant) -> Robot:
    """Get a robot."""
    return Robot.of(await cases.robots.get(tenant, robot_id))
