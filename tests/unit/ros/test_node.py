"""The node with a stand-in for rclpy: what it subscribes to, publishes and hands on. Real ROS is not installed here."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="in the extra `dev`: gives the messages' types")

from revisit_bridge.answers import Answer, Correction, News
from revisit_bridge.map_grid import MapGrid
from revisit_bridge.parameters import Parameters

from revisit.core.geometry import se3
from revisit.formats.occupancy_grid import GridOptions, grid_of
from revisit.sdk.spool import Spool
from tests.support.patience import eventually
from tests.support.ros_messages import Messages
from tests.unit.ros.test_bridge_output import loop, submap

# A thread that is only just connecting is not waited for, and finds its channel closed.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")

SECOND = 10**9


class FakeNode:
    """What is used of rclpy.node.Node."""

    overrides: dict[str, object] = {}

    def __init__(self, name: str) -> None:
        self.name, self.parameters_declared = name, {}
        self.subscriptions_made, self.publishers_made, self.services, self.timers = {}, {}, {}, []
        self.logged: list[str] = []

    def declare_parameter(self, name, default):
        self.parameters_declared[name] = self.overrides.get(name, default)

    def get_parameter(self, name):
        return SimpleNamespace(value=self.parameters_declared[name])

    def create_subscription(self, kind, topic, callback, qos):
        self.subscriptions_made[topic] = (kind, callback)
        return topic

    def destroy_subscription(self, topic):
        del self.subscriptions_made[topic]

    def create_publisher(self, kind, topic, qos):
        self.publishers_made[topic] = published = []
        return SimpleNamespace(publish=published.append, topic=topic)

    def destroy_publisher(self, publisher):
        del self.publishers_made[publisher.topic]

    def create_service(self, kind, name, callback):
        self.services[name] = callback
        return name

    def destroy_service(self, name):
        del self.services[name]

    def add_on_set_parameters_callback(self, callback):
        self.set_parameters = callback

    def create_timer(self, period, callback):
        self.timers.append(callback)
        return callback

    def destroy_timer(self, callback):
        self.timers.remove(callback)

    def get_logger(self):
        return SimpleNamespace(info=self.logged.append, warning=self.logged.append, error=self.logged.append)

    def get_clock(self):
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=50 * SECOND))

    def destroy_node(self):
        pass


class FakeLifecycleNode(FakeNode):
    """What is used of rclpy.lifecycle.LifecycleNode: transitions of its own entities."""

    def on_activate(self, state):
        return "success"

    def on_deactivate(self, state):
        return "success"


class NoTransform(Exception):
    pass


class FakeBuffer:
    """tf2 that knows base_link -> lidar."""

    def __init__(self, **_: object) -> None:
        pass

    def lookup_transform(self, target, source, time):
        if (target, source) != ("base_link", "lidar"):
            raise NoTransform
        return SimpleNamespace(transform=SimpleNamespace(
            translation=SimpleNamespace(x=0.0, y=0.0, z=1.5), rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
        ))  # fmt: skip


@pytest.fixture
def made(monkeypatch, tmp_path):
    """The node's module over stand-ins, and a node of it with odometry on a topic."""
    ros = Messages()
    sent: list[object] = []

    def module(name: str, **content: object) -> None:
        made = ModuleType(name)
        vars(made).update(content)
        monkeypatch.setitem(sys.modules, name, made)

    for package in ("builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "nav_msgs", "revisit_msgs",
                    "sensor_msgs", "std_msgs"):  # fmt: skip
        kinds = {name.rpartition("/")[2]: kind for name, kind in ros.types.items() if name.startswith(f"{package}/")}
        module(package)
        module(f"{package}.msg", **kinds)
    module("revisit_msgs.srv", AddAnchor=object)
    module("std_srvs")
    module("rcl_interfaces")
    module("rcl_interfaces.msg", SetParametersResult=lambda successful, reason="": (successful, reason))
    module("std_srvs.srv", Trigger=object)
    module("rclpy", init=None, spin=None, try_shutdown=None)
    module("rclpy.duration", Duration=lambda seconds: seconds)
    module("rclpy.executors", ExternalShutdownException=NoTransform)
    module("rclpy.node", Node=FakeNode)
    answers = SimpleNamespace(SUCCESS="success", FAILURE="failure")
    module("rclpy.lifecycle", LifecycleNode=FakeLifecycleNode, TransitionCallbackReturn=answers)
    qos = {"DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL=1), "QoSProfile": lambda **k: k}
    module("rclpy.qos", **qos, qos_profile_sensor_data="sensor data")
    module("rclpy.time", Time=lambda nanoseconds: nanoseconds)
    broadcaster = lambda node: SimpleNamespace(sendTransform=sent.append)  # noqa: E731
    module("tf2_ros", Buffer=FakeBuffer, TransformBroadcaster=broadcaster, TransformException=NoTransform,
           TransformListener=lambda *_: SimpleNamespace(unregister=lambda: None))  # fmt: skip
    for name in ("revisit_bridge.node", "revisit_bridge.lifecycle_node"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    nothing_listens = "127.0.0.1:1"
    monkeypatch.setattr("revisit.sdk.spooled_stream.CLOSE_S", 0.05)  # nobody answers: the stream would wait in vain
    monkeypatch.setattr(FakeNode, "overrides", {
        "service": nothing_listens, "odometry_topic": "odometry", "spool_dir": str(tmp_path), "robot_id": "spot",
        "send": "all",
    })  # fmt: skip
    node = importlib.import_module("revisit_bridge.node").BridgeNode()
    yield ros, node, sent
    node.destroy_node()
    sys.modules.pop("revisit_bridge.node", None)
    sys.modules.pop("revisit_bridge.lifecycle_node", None)


def test_the_node_declares_every_parameter_and_keeps_scans_without_a_link(made, tmp_path) -> None:
    ros, node, _ = made
    assert node.parameters_declared.keys() == {item.name for item in Parameters.declared()}
    take_cloud, take_odometry = node.subscriptions_made["points"][1], node.subscriptions_made["odometry"][1]
    for index in range(5):
        stamp = SECOND + index * SECOND // 10
        take_cloud(ros.cloud(np.random.default_rng(index).uniform(-9, 9, (500, 3)), stamp, "lidar"))
        take_odometry(ros.odometry(se3.from_yaw(0.0, (0.2 * index, 0.0, 0.0)), stamp))
    state = node.bridge.outbox.state
    assert state.pending == 5 and state.session.startswith("maps/default/sessions/spot-")
    assert any("session spot-" in line for line in node.logged)
    for timer in node.timers:
        timer()
    told = {item.key: item.value for item in node.publishers_made["/diagnostics"][0].status[0].values}
    assert told["scans waiting"] == "5"


def test_the_node_publishes_loops_the_graph_and_the_transform(made, monkeypatch) -> None:
    ros, node, sent = made
    take_cloud, take_odometry = node.subscriptions_made["points"][1], node.subscriptions_made["odometry"][1]
    take_cloud(ros.cloud(np.ones((50, 3)), SECOND, "lidar"))
    take_odometry(ros.odometry(np.eye(4), SECOND, "odom_lidar"))
    session = node.bridge.outbox.state.session
    answer = Answer(session, (submap("a/submaps/1", 0.0, 1),), (loop(1),), Correction(se3.from_yaw(1.0, (7, 0, 0)), 1))
    news = [News(answer, (loop(1),), (loop(2),))]
    monkeypatch.setattr(node.bridge, "news", lambda: [news.pop()] if news else [])
    for timer in node.timers:
        timer()
    assert [message.revoked for message in node.publishers_made["~/loop_closures"]] == [False, True]
    (graph,) = node.publishers_made["~/pose_graph"]
    assert (graph.header.frame_id, len(graph.loops)) == ("odom_lidar", 1)
    transform = sent[-1]
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "odom_lidar")
    assert (transform.transform.translation.x, transform.header.stamp.sec) == (7.0, 50)


def test_the_transform_of_a_session_that_has_ended_is_not_published(made, monkeypatch) -> None:
    _, node, sent = made
    answer = Answer("maps/default/sessions/earlier", (), (), Correction(np.eye(4), 1))
    monkeypatch.setattr(node.bridge, "news", lambda: [News(answer, (), ())])
    for timer in node.timers:
        timer()
    assert sent == []


def test_a_session_is_ended_on_request(made) -> None:
    ros, node, _ = made
    take_cloud, take_odometry = node.subscriptions_made["points"][1], node.subscriptions_made["odometry"][1]
    sessions = []
    for index in range(2):
        take_cloud(ros.cloud(np.ones((50, 3)), SECOND * (index + 1), "lidar"))
        take_odometry(ros.odometry(np.eye(4), SECOND * (index + 1)))
        sessions.append(node.bridge.outbox.state.session)
        assert node.services["~/end_session"](None, SimpleNamespace()).success
    assert len(set(sessions)) == 2


def test_a_robot_that_took_the_lift_goes_on_in_a_session_on_its_new_storey(made, tmp_path) -> None:
    ros, node, _ = made
    take_cloud, take_odometry = node.subscriptions_made["points"][1], node.subscriptions_made["odometry"][1]
    sessions = []
    for index, storey in enumerate(("", "B2", "B2")):
        assert node.set_parameters([SimpleNamespace(name="storey", value=storey)]) == (True, "")
        stamp = SECOND + index * SECOND // 10
        take_cloud(ros.cloud(np.ones((50, 3)), stamp, "lidar"))
        take_odometry(ros.odometry(se3.from_yaw(0.0, (0.2 * index, 0.0, 0.0)), stamp))
        sessions.append(node.bridge.outbox.state.session.rpartition("/")[2])
    assert sessions[0] != sessions[1] == sessions[2]
    beside = {file.name: file.read_text() for file in tmp_path.glob("*.storey")}
    assert beside == {f"{sessions[1]}.spool.storey": "B2"}


@pytest.mark.parametrize(("name", "value", "reason"), [
    ("storey", "a\nb", "at most 64 printable characters"), ("storey", "B" * 65, "at most 64 printable characters"),
    ("storey", "B2 ", "no blank before or behind"), ("map_id", "other", "map_id: read when the node starts"),
])  # fmt: skip
def test_what_cannot_be_set_while_the_node_runs_is_refused_with_the_reason(made, name, value, reason) -> None:
    _, node, _ = made
    successful, told = node.set_parameters([SimpleNamespace(name=name, value=value)])
    assert not successful and reason in told
    assert node.set_parameters([SimpleNamespace(name="use_sim_time", value=True)]) == (True, "")


def test_no_map_is_published_or_saved_where_none_is_wanted(made) -> None:
    _, node, _ = made
    assert "map" not in node.publishers_made
    answer = node.services["~/save_map"](None, SimpleNamespace())
    assert not answer.success and "grid_m is 0" in answer.message


def test_the_map_is_published_once_a_version_and_saved_on_request(made, monkeypatch, tmp_path) -> None:
    _, _, _ = made
    monkeypatch.setattr(FakeNode, "overrides", FakeNode.overrides | {"grid_m": 0.5, "map_folder": str(tmp_path)})
    node = sys.modules["revisit_bridge.node"].BridgeNode()
    try:
        assert node.services["~/save_map"](None, SimpleNamespace()).message == "no version of the map yet"
        points = np.array([(0.2, 0.2, 0.0), (0.3, 0.2, 1.0), (1.2, 0.2, 0.0)])
        node.grids._made = MapGrid(7, "frame-1", grid_of(points, GridOptions(resolution_m=0.5)))
        for _ in range(2):
            for timer in node.timers:
                timer()
        (told,) = node.publishers_made["map"]
        assert (told.header.frame_id, told.info.width, told.info.height) == ("map", 3, 1)
        assert told.data.tolist() == [100, -1, 0]
        answer = node.services["~/save_map"](None, SimpleNamespace())
        assert answer.success and "version 7" in answer.message
        assert (tmp_path / "default.pgm").is_file() and "default.pgm" in (tmp_path / "default.yaml").read_text()
    finally:
        node.destroy_node()


def test_a_version_of_the_map_is_asked_for_and_a_refusal_goes_to_the_log(made) -> None:
    _, node, _ = made
    assert node.services["~/optimise_map"](None, SimpleNamespace()).success
    eventually(lambda: any(line.startswith("no new version of the map") for line in node.logged))


def test_fixes_are_taken_where_a_topic_is_named_and_what_waits_is_told(made, monkeypatch) -> None:
    ros, without, _ = made
    assert "fix" not in without.subscriptions_made
    without.destroy_node()
    monkeypatch.setattr(FakeNode, "overrides", FakeNode.overrides | {"fix_topic": "fix"})
    node = sys.modules["revisit_bridge.node"].BridgeNode()
    try:
        kind, take_fix = node.subscriptions_made["fix"]
        assert kind is ros.types["sensor_msgs/msg/NavSatFix"]
        for tenth in range(3):
            stamp = SECOND + tenth * SECOND // 10
            node.subscriptions_made["points"][1](ros.cloud(np.ones((50, 3)), stamp, "lidar"))
            node.subscriptions_made["odometry"][1](ros.odometry(se3.from_yaw(0.0, (2.0 * tenth, 0.0, 0.0)), stamp))
            take_fix(ros.fix(stamp, "lidar", status=-1 if tenth == 1 else 0))
        for timer in node.timers:
            timer()
        told = {item.key: item.value for item in node.publishers_made["/diagnostics"][0].status[0].values}
        assert (told["anchors waiting"], told["fixes without a place"], told["fixes left out"]) == ("2", "1", "0")
    finally:
        node.destroy_node()


def test_clouds_of_livox_are_subscribed_to_by_the_message_of_its_driver(made, monkeypatch) -> None:
    kind, driver = type("CustomMsg", (), {}), ModuleType("livox_ros_driver2.msg")
    driver.CustomMsg = kind
    monkeypatch.setitem(sys.modules, "livox_ros_driver2", ModuleType("livox_ros_driver2"))
    monkeypatch.setitem(sys.modules, "livox_ros_driver2.msg", driver)
    monkeypatch.setattr(FakeNode, "overrides", FakeNode.overrides | {"cloud_type": "livox_ros_driver2/CustomMsg"})
    made[1].destroy_node()
    node = sys.modules["revisit_bridge.node"].BridgeNode()
    assert node.subscriptions_made["points"][0] is kind
    node.destroy_node()


def test_a_point_is_added_by_a_service_and_kept(made) -> None:
    ros, node, _ = made
    asked = ros.add_anchor("door-7", (4.0, 0.0, 0.0), local_m=(1.0, 2.0, 3.0))
    answer = node.services["~/add_anchor"](asked, SimpleNamespace())
    assert not answer.success and "there was no scan" in answer.message
    node.subscriptions_made["points"][1](ros.cloud(np.ones((50, 3)), SECOND, "lidar"))
    node.subscriptions_made["odometry"][1](ros.odometry(np.eye(4), SECOND))
    assert node.services["~/add_anchor"](asked, SimpleNamespace()).success
    assert node.bridge.outbox.state.anchors_waiting == 1


@pytest.fixture
def managed(made):
    """A lifecycle node over the same stand-ins, unconfigured."""
    ros, _, sent = made
    node = importlib.import_module("revisit_bridge.lifecycle_node").LifecycleBridgeNode()
    yield ros, node, sent
    node.destroy_node()


def connected(node) -> tuple[int, int, int, int]:
    """Subscriptions, services, timers and publishers that it has."""
    return len(node.subscriptions_made), len(node.services), len(node.timers), len(node.publishers_made)


def test_a_managed_node_takes_clouds_in_only_while_it_is_active(managed) -> None:
    ros, node, _ = managed
    assert connected(node) == (0, 0, 0, 0) and node.bridge is None
    assert node.on_configure(None) == "success" and connected(node) == (0, 0, 0, 4)
    sessions = []
    for start_s in (1, 2):  # sessions go on over a short time of rest
        assert node.on_activate(None) == "success" and connected(node) == (2, 5, 3, 4)
        node.subscriptions_made["points"][1](ros.cloud(np.ones((50, 3)), SECOND * start_s, "lidar"))
        node.subscriptions_made["odometry"][1](ros.odometry(np.eye(4), SECOND * start_s))
        for timer in node.timers:
            timer()
        sessions.append(node.bridge.outbox.state.session)
        assert node.on_deactivate(None) == "success" and connected(node) == (0, 0, 0, 4)
    assert sessions[0] == sessions[1] and node.bridge.outbox.state.pending == 2
    assert node.on_cleanup(None) == "success"
    assert connected(node) == (0, 0, 0, 0) and node.bridge is None
    assert node.on_configure(None) == "success"
    assert node.bridge.outbox.state.session == sessions[0]  # scans that wait are on the disk
    assert node.on_shutdown(None) == "success" and connected(node) == (0, 0, 0, 0)


def test_parameters_of_a_managed_node_are_set_before_it_is_configured(managed) -> None:
    _, node, _ = managed
    map_id = SimpleNamespace(name="map_id", value="other")
    assert node.set_parameters([map_id]) == (True, "")
    node.parameters_declared["poll_s"] = 0.0
    assert node.on_configure(None) == "failure" and node.bridge is None
    assert any("poll_s must be positive" in line for line in node.logged)
    node.parameters_declared |= {"poll_s": 5.0, "map_id": "other"}
    assert node.on_configure(None) == "success"
    assert not node.set_parameters([map_id])[0]


def test_a_managed_node_whose_spool_another_process_has_stays_unconfigured(managed, tmp_path) -> None:
    _, node, _ = managed
    Spool(tmp_path / "friday.spool", "maps/default/sessions/friday").close()
    spool = Spool(tmp_path / "monday.spool", "maps/default/sessions/monday")
    assert node.on_configure(None) == "failure" and node.bridge is None
    assert any("another process uses" in line for line in node.logged)
    spool.close()
    assert node.on_configure(None) == "success"
