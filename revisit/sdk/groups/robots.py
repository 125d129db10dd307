"""Robots."""

from __future__ import annotations

import builtins

from revisit.sdk import names
from revisit.sdk.groups.group import Group
from revisit.sdk.names import name_of
from revisit.sdk.resources import Robot


class Robots(Group):
    """`client.robots`."""

    def create(self, robot_id: str, *, display_name: str = "") -> Robot:
        """Create a robot."""
        return Robot.of(self._ask("CreateRobot", robot_id=robot_id, display_name=display_name))

    def get(self, name: str) -> Robot:
        """Get `robots/{robot}`."""
        return Robot.of(self._ask("GetRobot", name=name_of(name, names.ROBOT)))

    def list(self) -> builtins.list[Robot]:
        """All robots, oldest first."""
        return self._list(Robot, "ListRobots")
