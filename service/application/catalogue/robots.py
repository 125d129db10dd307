"""Robots: who drives. A session may name the robot that recorded it."""

from __future__ import annotations

from dataclasses import dataclass

from revisit.service.application.catalogue.paging import Page, PageRequest, page_of
from revisit.service.application.contract.context import Context
from revisit.service.application.contract.errors import AlreadyExists, NotFound
from revisit.service.application.contract.identity import TenantId, content_hash, validated_id, validated_label
from revisit.service.application.contract.ports import UnitOfWork
from revisit.service.application.contract.records import RobotRecord


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


class Robots:
    """Create, get and list robots."""

    def __init__(self, context: Context) -> None:
        """All calls use `context`."""
        self._context = context

    async def create(self, tenant: TenantId, command: CreateRobot) -> CreatedRobot:
        """Create a robot. Raises BadField; AlreadyExists where the id is taken by other content; Draining."""
        self._context.admit()
        record = RobotRecord(
            tenant=tenant,
            robot_id=validated_id(command.robot_id, "robot_id"),
            content_hash=content_hash([validated_label(command.display_name, "display_name")]),
            display_name=command.display_name,
            created_at_ns=self._context.clock.wall_ns(),
        )

        def add(uow: UnitOfWork) -> CreatedRobot:
            known = uow.robots.get(tenant, command.robot_id)
            if known is None:
                return CreatedRobot(_view(uow.robots.add(record)), replay=False)
            if known.content_hash != record.content_hash:
                raise AlreadyExists(f"robot {command.robot_id} exists with other content")
            return CreatedRobot(_view(known), replay=True)

        return await self._context.write(add)

    async def get(self, tenant: TenantId, robot_id: str) -> RobotView:
        """Raises NotFound."""
        return _view(await self._context.read(lambda uow: require_robot(uow, tenant, robot_id)))

    async def list(self, tenant: TenantId, page: PageRequest) -> Page[RobotView]:
        """The tenant's robots, oldest first."""
        records = await self._context.read(lambda uow: uow.robots.find(tenant, after=page.after, limit=page.size + 1))
        return page_of(records, page, _view)


def require_robot(uow: UnitOfWork, tenant: TenantId, robot_id: str) -> RobotRecord:
    """The robot. Raises NotFound."""
    record = uow.robots.get(tenant, robot_id)
    if record is None:
        raise NotFound(f"there is no robot {robot_id!r}"[:200])
    return record


def _view(record: RobotRecord) -> RobotView:
    return RobotView(record.robot_id, record.display_name, record.created_at_ns)
