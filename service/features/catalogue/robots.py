"""Robots. A session may name the robot that recorded it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from revisit.service.domain.identity import TenantId, content_hash, validated_id, validated_label
from revisit.service.domain.records import RobotRecord
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, as_it_is
from revisit.service.ports.storage import require_robot, require_same_content
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class CreateRobot:
    """A new robot."""

    robot_id: str
    display_name: str = ""


@dataclass(frozen=True)
class CreatedRobot:
    """The robot, and whether an earlier identical request had created it."""

    robot: RobotRecord
    replay: bool


class Robots:
    """Create, get and list robots."""

    def __init__(self, context: CallContext) -> None:
        """Robots are kept in the storage of the context."""
        self._context = context

    async def create(self, tenant: TenantId, command: CreateRobot) -> CreatedRobot:
        """Create a robot.

        Raises BadField; AlreadyExists where the id is taken by other content; Draining, RateLimited.
        """
        self._context.admission.charge_creation(tenant)
        record = RobotRecord(
            tenant=tenant,
            robot_id=validated_id(command.robot_id, "robot_id"),
            content_hash=content_hash([validated_label(command.display_name, "display_name")]),
            display_name=command.display_name,
            created_at_ns=self._context.clock.wall_ns(),
        )
        return await self._context.storage.write(partial(_add, record=record))

    async def get(self, tenant: TenantId, robot_id: str) -> RobotRecord:
        """Raises NotFound."""
        return await self._context.storage.read(partial(require_robot, tenant=tenant, robot_id=robot_id))

    async def list(self, tenant: TenantId, page: PageRequest) -> Page[RobotRecord]:
        """The tenant's robots, oldest first."""
        return await self._context.lists.page(
            tenant,
            page,
            lambda uow, after, limit: uow.robots.find(tenant, after=after, limit=limit),
            as_it_is,
        )


def _add(uow: UnitOfWork, record: RobotRecord) -> CreatedRobot:
    known = uow.robots.get(record.tenant, record.robot_id)
    if known is None:
        return CreatedRobot(uow.robots.add(record), replay=False)
    require_same_content(known.content_hash, record.content_hash, f"robot {record.robot_id}")
    return CreatedRobot(known, replay=True)
