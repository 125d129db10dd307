"""The same node as a managed one (ROS 2 lifecycle): configure, activate, deactivate, clean up."""

from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from revisit.core.errors import RevisitError
from revisit_bridge.node import NAME, BridgeParts
from revisit_bridge.node import main as run


class LifecycleBridgeNode(BridgeParts, LifecycleNode):
    """`revisit_bridge` that a lifecycle manager drives. Parameters are read when it is configured."""

    def __init__(self) -> None:
        super().__init__(NAME)
        self.declare()

    def on_configure(self, _: Any) -> Any:
        """Make the bridge, which sends scans of an earlier run that wait."""
        try:
            self.configure()
        except (ValueError, OSError, RevisitError) as error:
            self.get_logger().error(f"cannot be configured: {error}")
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: Any) -> Any:
        """Let clouds in and news out."""
        self.activate()
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> Any:
        """Take no cloud in and publish nothing; scans that wait are still sent."""
        self.deactivate()
        return super().on_deactivate(state)

    def on_cleanup(self, _: Any) -> Any:
        """Let go of the bridge."""
        self.clean_up()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, _: Any) -> Any:
        """Let go of everything, from any state."""
        self.deactivate()
        self.clean_up()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """As `on_shutdown`, where no manager has asked for it."""
        self.deactivate()
        self.clean_up()
        super().destroy_node()


def main() -> None:
    """`ros2 run revisit_bridge lifecycle_bridge`."""
    run(LifecycleBridgeNode)


if __name__ == "__main__":
    main()
