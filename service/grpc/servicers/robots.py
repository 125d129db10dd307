"""RobotService."""

from __future__ import annotations

from typing import Any

from revisit.service.application import UseCases
from revisit.service.application.catalogue.robots import CreateRobot
from revisit.service.grpc.tenancy import tenant_of
from revisit.service.wire import answers, names, requests
from revisit.service.wire.rendering import page_message
from revisit.v1 import robot_pb2 as pb
from revisit.v1 import robot_pb2_grpc


class RobotServicer(robot_pb2_grpc.RobotServiceServicer):
    """Create, get and list robots."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._robots = use_cases.robots

    async def CreateRobot(self, request: pb.CreateRobotRequest, context: Any) -> pb.CreateRobotResponse:
        """Create a robot."""
        created = await self._robots.create(tenant_of(context), CreateRobot(request.robot_id, request.display_name))
        return pb.CreateRobotResponse(robot=answers.of_robot(created.robot), replay=created.replay)

    async def GetRobot(self, request: pb.GetRobotRequest, context: Any) -> pb.GetRobotResponse:
        """Get a robot."""
        view = await self._robots.get(tenant_of(context), names.robot_id(request.name))
        return pb.GetRobotResponse(robot=answers.of_robot(view))

    async def ListRobots(self, request: pb.ListRobotsRequest, context: Any) -> pb.ListRobotsResponse:
        """List the robots."""
        page = await self._robots.list(tenant_of(context), requests.page(request))
        return await page_message(pb.ListRobotsResponse, "robots", page, answers.of_robot)
