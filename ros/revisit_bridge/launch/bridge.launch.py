"""`ros2 launch revisit_bridge bridge.launch.py cloud_topic:=/points odometry_topic:=/kiss/odometry`."""

from __future__ import annotations

from pathlib import Path

import yaml
from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from revisit_bridge.parameters import Parameters


def generate_launch_description() -> LaunchDescription:
    """The node with the parameters of a file, and over them those that are given as arguments."""
    given = [
        DeclareLaunchArgument(item.name, default_value="", description=item.metadata["meaning"])
        for item in Parameters.declared()
    ]
    file = DeclareLaunchArgument("params_file", default_value=str(_shared("bridge.yaml")))
    rviz = DeclareLaunchArgument("rviz", default_value="false", description="also start RViz with config/bridge.rviz")
    managed = DeclareLaunchArgument("lifecycle", default_value="false", description="a node that a manager activates")
    return LaunchDescription([*given, file, rviz, managed, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    def said(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    own = {item.name: _as(item.default, text) for item in Parameters.declared() if (text := said(item.name))}
    managed = said("lifecycle") == "true"
    kind = LifecycleNode if managed else Node
    bridge = kind(
        package="revisit_bridge",
        executable="lifecycle_bridge" if managed else "bridge",
        name="revisit_bridge",
        namespace="",
        output="screen",
        parameters=[said("params_file"), own],
    )
    clouds = said("cloud_topic") or Parameters().cloud_topic
    return [bridge, _rviz(clouds)] if said("rviz") == "true" else [bridge]


def _as(default: object, text: str) -> object:
    """An argument in the type of its parameter: ROS takes no whole number for a float, and `7` for no text."""
    if isinstance(default, str):
        return ParameterValue(text, value_type=str)
    return float(text) if isinstance(default, float) else yaml.safe_load(text)


def _rviz(cloud_topic: str) -> Node:
    """RViz with the map, the clouds and the frames."""
    return Node(
        package="rviz2",
        executable="rviz2",
        name="rviz",
        arguments=["-d", str(_shared("bridge.rviz"))],
        remappings=[("/points", cloud_topic)],
    )


def _shared(name: str) -> Path:
    return Path(get_package_share_directory("revisit_bridge")) / "config" / name
