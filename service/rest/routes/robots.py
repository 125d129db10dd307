"""`/v1/robots`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Response

from revisit.service.application.access.callers import Scope
from revisit.service.rest.access import allows
from revisit.service.rest.answers import Robot, RobotPage, answer, answers, page_answer
from revisit.service.rest.bodies import describe_json, json_body
from revisit.service.rest.parameters import Cases, Id, Paging, Tenant
from revisit.service.rest.schemas import CreateRobotRequest
from revisit.service.wire.answers import of_robot

router = APIRouter(prefix="/v1/robots", tags=["robots"])


@router.post(
    "", **answers(Robot, 201), openapi_extra=describe_json(CreateRobotRequest), dependencies=[allows(Scope.INGEST)]
)
async def create_robot(
    body: Annotated[CreateRobotRequest, json_body(CreateRobotRequest)], cases: Cases, tenant: Tenant
) -> Response:
    """Create a robot; idempotent like a map."""
    created = await cases.robots.create(tenant, body.command())
    return answer(Robot, of_robot(created.robot), 201, replay=created.replay)


@router.get("", **answers(RobotPage), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_robots(cases: Cases, tenant: Tenant, paging: Paging) -> Response:
    """List the robots, oldest first."""
    return await page_answer(RobotPage, "robots", await cases.robots.list(tenant, paging), of_robot)


@router.get("/{robot_id}", **answers(Robot), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def get_robot(robot_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Get a robot."""
    return answer(Robot, of_robot(await cases.robots.get(tenant, robot_id)))
