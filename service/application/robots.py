"""Robots: who drives. A session may name the robot that recorded it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from service.application.identity import TenantId
from service.application.paging import Page, PageRequest


@dataclass(frozen=True)
class CreateRobot:
    """A new robot."""

    robot_id: str
    display_name: str = ""


@dataclass(frozen=True)
class RobotView:
    """A robot as clients see it."""

    robot_id: str
    display_name: str
    created_at_ns: int


@dataclass(frozen=True)
class CreatedRobot:
    """The robot, and whether an earlier identical request had created it."""

    robot: RobotView
    replay: bool


class Robots(Protocol):
    """Create, get and list robots."""

    async def create(self, tenant: TenantId, command: CreateRobot) -> CreatedRobot:
        """Create a robot. Raises BadField; AlreadyExists where the id is taken by other content."""
        ...

    async def get(self, tenant: TenantId, robot_id: str) -> RobotView:
        """Raises NotFound."""
        ...

    async def list(self, tenant: TenantId, page: PageRequest) -> Page[RobotView]:
        """The tenant's robots, oldest first."""
        ...
