"""`ros2 launch revisit_bridge bridge.launch.py cloud_topic:=/points odometry_topic:=/kiss/odometry`."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node

OFTEN_SET = ("service", "map_id", "robot_id", "cloud_topic", "odometry_topic", "fix_topic", "odom_frame", "map_frame")


def generate_launch_description() -> LaunchDescription:
    """The node with the parameters of a file, and over them those that are given as arguments."""
    config = Path(get_package_share_directory("revisit_bridge")) / "config" / "bridge.yaml"
    given = [DeclareLaunchArgument(name, default_value="", description="as the file says") for name in OFTEN_SET]
    file = DeclareLaunchArgument("params_file", default_value=str(config))
    grid = DeclareLaunchArgument("grid_m", default_value="", description="metres of a cell of the map; 0: none")
    rviz = DeclareLaunchArgument("rviz", default_value="false", description="also start RViz with config/bridge.rviz")
    managed = DeclareLaunchArgument("lifecycle", default_value="false", description="a node that a manager activates")
    return LaunchDescription([*given, grid, file, rviz, managed, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    values = {name: LaunchConfiguration(name).perform(context) for name in OFTEN_SET}
    file, grid = (LaunchConfiguration(name).perform(context) for name in ("params_file", "grid_m"))
    own = {name: value for name, value in values.items() if value} | ({"grid_m": float(grid)} if grid else {})
    managed = LaunchConfiguration("lifecycle").perform(context) == "true"
    kind = LifecycleNode if managed else Node
    bridge = kind(
        package="revisit_bridge",
        executable="lifecycle_bridge" if managed else "bridge",
        name="revisit_bridge",
        namespace="",
        output="screen",
        parameters=[file, own],
    )
    return [bridge, _rviz()] if LaunchConfiguration("rviz").perform(context) == "true" else [bridge]


def _rviz() -> Node:
    """RViz with the map, the clouds and the frames."""
    config = Path(get_package_share_directory("revisit_bridge")) / "config" / "bridge.rviz"
    return Node(package="rviz2", executable="rviz2", name="rviz", arguments=["-d", str(config)])
