"""The launch file with a stand-in for `launch`: the nodes that it starts, and their parameters."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import NamedTuple

import pytest
import yaml
from revisit_bridge.parameters import Parameters

BRIDGE = Path(__file__).resolve().parents[3] / "ros/revisit_bridge"
PAGES = [BRIDGE / "README.md", *(BRIDGE.parents[1] / "docs").rglob("*ros*.md")]


class Text(NamedTuple):
    """`launch_ros` reads a text as YAML, so that `7` is a number, unless its type is said."""

    text: str
    kind: type


class Launch:
    """What is used of `launch`: arguments with their defaults, and a function that is called with their texts."""

    def __init__(self, monkeypatch):
        self.defaults, self.function, self.texts = {}, None, {}
        for name, content in {
            "ament_index_python": {},
            "ament_index_python.packages": {"get_package_share_directory": lambda name: str(BRIDGE)},
            "launch": {"LaunchContext": object, "LaunchDescription": list},
            "launch.actions": {"DeclareLaunchArgument": self._declared, "OpaqueFunction": self._opaque},
            "launch.substitutions": {"LaunchConfiguration": self._configuration},
            "launch_ros": {},
            "launch_ros.actions": {kind: self._node(kind) for kind in ("Node", "LifecycleNode")},
            "launch_ros.parameter_descriptions": {"ParameterValue": lambda value, value_type: Text(value, value_type)},
        }.items():
            module = ModuleType(name)
            vars(module).update(content)
            monkeypatch.setitem(sys.modules, name, module)

    def _declared(self, name, default_value, description=""):
        self.defaults[name] = default_value

    def _opaque(self, function):
        self.function = function

    def _configuration(self, name):
        return SimpleNamespace(perform=lambda context: (self.defaults | context)[name])

    @staticmethod
    def _node(kind):
        return lambda **told: SimpleNamespace(kind=kind, **told)

    def nodes(self, **arguments):
        """The nodes that a launch with these arguments starts."""
        runpy.run_path(str(BRIDGE / "launch/bridge.launch.py"))["generate_launch_description"]()
        assert arguments.keys() <= self.defaults.keys()
        return self.function(arguments)


@pytest.fixture
def launch(monkeypatch):
    return Launch(monkeypatch)


def test_without_arguments_the_node_runs_with_its_file_alone(launch):
    (node,) = launch.nodes()
    file, own = node.parameters
    assert (node.kind, node.package, node.executable, own) == ("Node", "revisit_bridge", "bridge", {})
    assert Parameters.of(yaml.safe_load(Path(file).read_text())[node.name]["ros__parameters"]) == Parameters()


def test_every_parameter_can_be_given_in_its_type(launch):
    texts = {"send": "all", "map_id": "7", "deskew": "false", "grid_m": "1", "spool_max_mb": "9", "cloud_topic": "/os"}
    (node,) = launch.nodes(**texts)
    assert node.parameters[1] == {
        "send": ("all", str), "map_id": ("7", str), "deskew": False, "grid_m": 1.0, "spool_max_mb": 9,
        "cloud_topic": ("/os", str),
    }  # fmt: skip
    assert isinstance(node.parameters[1]["grid_m"], float)
    assert launch.defaults.keys() - {"params_file", "rviz", "lifecycle"} == {p.name for p in Parameters.declared()}


def test_the_executables_are_those_that_the_package_installs(launch):
    setup = (BRIDGE / "setup.py").read_text()
    for lifecycle, kind in (("false", "Node"), ("true", "LifecycleNode")):
        (node,) = launch.nodes(lifecycle=lifecycle)
        (module,) = re.findall(rf'"{node.executable} = \{{NAME\}}\.(\w+):main"', setup)
        assert node.kind == kind and "def main(" in (BRIDGE / f"revisit_bridge/{module}.py").read_text()


def test_rviz_shows_the_clouds_of_the_topic_that_was_given(launch):
    _, rviz = launch.nodes(rviz="true", cloud_topic="/ouster/points")
    shown = yaml.safe_load(Path(rviz.arguments[1]).read_text())["Visualization Manager"]["Displays"]
    assert rviz.remappings == [("/points", "/ouster/points")]
    assert "/points" in [display["Topic"]["Value"] for display in shown if "Topic" in display]


def test_pages_launch_with_arguments_that_there_are(launch):
    launch.nodes()
    named = {name for page in PAGES for name in re.findall(r"\b(\w+):=", page.read_text())}
    assert named and named <= launch.defaults.keys()
