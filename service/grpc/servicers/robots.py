"""RobotService."""

from __future__ import annotations

from typing import Any

from revisit.service.application import UseCases
from revisit.service.application.catalogue.robots import CreateRobot
from revisit.service.grpc import messages, names
from revisit.service.grpc.tenancy import tenant_of
from revisit.v1 import robot_pb2, robot_pb2_grpc


class RobotServicer(robot_pb2_grpc.RobotServiceServicer):
    """Create, get and list robots."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._robots = use_cases.robots

    async def CreateRobot(self, request: robot_pb2.CreateRobotRequest, context: Any) -> robot_pb2.CreateRobotResponse:
        """Create a robot."""
        created = await self._robots.create(tenant_of(context), CreateRobot(request.robot_id, request.display_name))
        return robot_pb2.CreateRobotResponse(robot=messages.robot_message(created.robot), replay=created.replay)

    async def GetRobot(self, request: robot_pb2.GetRobotRequest, context: Any) -> robot_pb2.GetRobotResponse:
        """Get a robot."""
        view = await self._robots.get(tenant_of(context), names.robot_id(request.name))
        return robot_pb2.GetRobotResponse(robot=messages.robot_message(view))

    async def ListRobots(self, request: robot_pb2.ListRobotsRequest, context: Any) -> robot_pb2.ListRobotsResponse:
        """List the robots."""
        page = await self._robots.list(tenant_of(context), messages.page_request(request))
        items = [messages.robot_message(view) for view in page.items]
        return robot_pb2.ListRobotsResponse(robots=items, next_page_token=page.next_token)
