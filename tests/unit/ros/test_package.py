"""The ROS 2 packages as such: parameters, files and dependencies agree with each other and with the README."""

from __future__ import annotations

import ast
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml
from revisit_bridge.parameters import Parameters, as_table

ROS = Path(__file__).resolve().parents[3] / "ros"
BRIDGE = ROS / "revisit_bridge"
NAMES = {item.name for item in Parameters.declared()}
SOURCES = sorted((BRIDGE / "revisit_bridge").glob("*.py"))
OF_ROS = {"rclpy", "tf2_ros", "launch", "launch_ros", "ament_index_python"}


def imports(source: Path) -> set[str]:
    nodes = list(ast.walk(ast.parse(source.read_text())))
    named = {alias.name.split(".")[0] for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    return named | {str(node.module).split(".")[0] for node in nodes if isinstance(node, ast.ImportFrom)}


def test_the_readme_has_the_table_of_parameters() -> None:
    assert as_table() in (BRIDGE / "README.md").read_text()


def test_only_the_node_needs_ros() -> None:
    ros = OF_ROS | {"sensor_msgs", "nav_msgs", "geometry_msgs", "std_msgs", "std_srvs", "diagnostic_msgs"}
    assert [source.name for source in SOURCES if imports(source) & (ros | {"revisit_msgs"})] == [
        "lifecycle_node.py",
        "node.py",
    ]


def test_what_the_node_imports_is_declared() -> None:
    declared = {item.text for item in ET.parse(BRIDGE / "package.xml").getroot().iter("exec_depend")}
    needed = imports(BRIDGE / "revisit_bridge/node.py") | imports(BRIDGE / "launch/bridge.launch.py")
    needed |= imports(BRIDGE / "revisit_bridge/lifecycle_node.py")
    python = {
        "collections",
        "importlib",
        "logging",
        "threading",
        "time",
        "pathlib",
        "yaml",  # python3-yaml
        "typing",
        "__future__",
        "revisit",
        "revisit_bridge",
        "builtin_interfaces",
    }
    assert needed - python <= declared


def test_the_file_of_parameters_sets_what_exists() -> None:
    told = yaml.safe_load((BRIDGE / "config/bridge.yaml").read_text())["revisit_bridge"]["ros__parameters"]
    assert told.keys() <= NAMES
    assert Parameters.of(told) == Parameters()


def test_every_message_is_generated_and_every_file_installed() -> None:
    cmake = (ROS / "revisit_msgs/CMakeLists.txt").read_text()
    assert set(re.findall(r"(?:msg|srv)/\w+\.(?:msg|srv)", cmake)) == {
        f"{kind}/{file.name}" for kind in ("msg", "srv") for file in (ROS / "revisit_msgs" / kind).iterdir()
    }
    setup = (BRIDGE / "setup.py").read_text()
    assert all((BRIDGE / name).is_file() for name in ("resource/revisit_bridge", "package.xml", "setup.cfg"))
    assert all(name in setup for name in ("launch/bridge.launch.py", "config/bridge.yaml", "config/bridge.rviz"))


def test_the_recipe_of_continuous_integration_builds_the_packages_that_there_are() -> None:
    (job,) = yaml.safe_load((ROS / "ci.yaml").read_text())["jobs"].values()
    script = "\n".join(step.get("run", "") for step in job["steps"])
    (selected,) = re.findall(r"--packages-select (.*)", script)
    names = {str(ET.parse(file).getroot().findtext("name")) for file in ROS.glob("*/package.xml")}
    assert set(selected.split()) == names
    shown = re.findall(r"show (\w+/(msg|srv)/\w+)", script)
    assert len(shown) == 2 and all((ROS / f"{name}.{kind}").is_file() for name, kind in shown)
    assert "launch revisit_bridge bridge.launch.py" in script and "import lifecycle_node, node" in script


def test_rviz_shows_topics_that_the_node_has() -> None:
    told = yaml.safe_load((BRIDGE / "config/bridge.rviz").read_text())["Visualization Manager"]
    topics = {display["Topic"]["Value"] for display in told["Displays"] if "Topic" in display}
    readme = (BRIDGE / "README.md").read_text()
    assert topics == {"/map", "/points", "/revisit_bridge/relocalised"}
    assert all(f"`{name}`" in readme for name in ("map", "~/relocalised"))
    assert told["Global Options"]["Fixed Frame"] == Parameters().map_frame
    assert f"/{Parameters().cloud_topic}" in topics


@pytest.mark.parametrize(
    "wrong",
    [
        {"poll_s": 0.0},
        {"cloud_topic": ""},
        {"map_frame": "odom"},
        {"max_gap_s": -1.0},
        {"grid_m": -0.1},
        {"cloud_type": "a/B"},
    ],
    ids=str,
)
def test_parameters_that_cannot_be_are_refused(wrong) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Parameters.of(wrong)
