"""The ROS 2 bridge's logic against the real service: drives, reboots, no link, sessions that are lost."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="in the extra `dev`: gives the messages' types")

from revisit_bridge.answers import Answer, ServiceAnswers
from revisit_bridge.bridge import Bridge
from revisit_bridge.outbox import Outbox, ServiceSessions
from revisit_bridge.pairing import Unknown
from revisit_bridge.parameters import Parameters

from revisit import Client
from revisit.core.geometry import se3
from revisit.sdk.errors import ApiError, ErrorDetails, NotFound
from revisit.sdk.retry import RetryPolicy
from tests.support.live_service import live_service
from tests.support.patience import PATIENCE_S, eventually
from tests.support.ros_messages import Messages
from tests.support.service_world import cloud_points

SECOND = 10**9
QUICK = RetryPolicy(attempts=2, base_s=0.01, cap_s=0.05)
NOWHERE = "127.0.0.1:1"


@pytest.fixture(scope="module")
def service():
    with live_service() as running:
        yield running


@pytest.fixture(scope="module")
def ros():
    return Messages()


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    """Reconnect at once: these tests wait for it."""
    monkeypatch.setattr("revisit.sdk.client.RECONNECT", RetryPolicy(attempts=1, base_s=0.01, cap_s=0.1))
    monkeypatch.setattr("revisit_bridge.outbox.RETRY_S", 0.1)


class Robot:
    """A robot with the bridge: odometry and clouds go in as ROS sends them."""

    def __init__(
        self, ros: Messages, grpc: str, folder: Path, map_id: str, boot: str = "boot 1", storey: str = ""
    ) -> None:
        self.ros = ros
        self.client = Client.grpc(grpc, retry=QUICK)
        own = Parameters(map_id=map_id, robot_id="spot", odometry_topic="odometry", poll_s=0.05, storey=storey)
        outbox = Outbox(folder, map_id, ServiceSessions(self.client, "spot", 2**30), time.monotonic, storey)
        answers = ServiceAnswers(self.client)
        unknown = lambda target, source, stamp: Unknown.NOT_YET  # noqa: E731
        self.bridge = Bridge(own, unknown, outbox, answers, boot, folder / "last_scan.json", time.monotonic)
        self.bridge.start()

    def drive(self, first: int, last: int, stop_at: int = 1_000, fixes: bool = False) -> None:
        """Half a metre every tenth of a second, up to a scan, then none; clouds come before their poses.

        With `fixes` the antenna is at the sensor, and tells its place with each scan.
        """
        for index in range(first, last + 1):
            stamp = 1000 * SECOND + index * SECOND // 10
            pose = se3.from_yaw(0.0, (0.5 * min(index, stop_at), 0.0, 0.0))
            self.bridge.take_cloud(self.ros.cloud(cloud_points(index), stamp, "base_link"))
            self.bridge.take_odometry(self.ros.odometry(pose, stamp))
            if fixes:
                self.bridge.take_fix(self.ros.fix(stamp, "base_link", (48.1 + 1e-5 * index, 11.5, 520.0)))

    @property
    def session(self) -> str:
        return self.bridge.outbox.state.session

    def until(self, condition) -> None:
        eventually(condition, f"{self.bridge.outbox.state} {self.bridge.problem}")

    def off(self) -> None:
        self.bridge.close()
        self.client.close()


@pytest.fixture
def robot_in(ros, service, tmp_path, request):
    """Makes robots that share a disk and a map; they are switched off at the end."""
    made: list[Robot] = []

    def make(grpc: str | None = None, boot: str = "boot 1", storey: str = "") -> Robot:
        map_id = f"m{abs(hash(request.node.name))}"
        made.append(Robot(ros, grpc or service.grpc, tmp_path, map_id, boot, storey))
        return made[-1]

    yield make
    for robot in made:
        robot.off()


def stored(robot: Robot) -> int:
    """The scans of the session, which the bridge creates when it first has something to send."""
    try:
        return robot.client.get_session(robot.session).committed_seq
    except NotFound:
        return 0


def test_a_drive_arrives_whole_and_standing_still_sends_nothing(robot_in) -> None:
    robot = robot_in()
    robot.drive(0, 40, stop_at=20)
    robot.until(lambda: robot.bridge.outbox.state.pending == 0 and stored(robot) >= 21)
    assert stored(robot) == 21
    session = robot.client.get_session(robot.session)
    assert session.robot == "robots/spot" and session.state == "ACTIVE"


def test_a_refusal_while_spools_are_looked_after_is_told_and_the_bridge_goes_on(robot_in, monkeypatch, caplog) -> None:
    robot, refused = robot_in(), threading.Event()
    outbox_tends = robot.bridge.outbox.tend

    def tend() -> None:
        if not refused.is_set():
            refused.set()
            raise ApiError(ErrorDetails("INTERNAL", "INTERNAL", "the spool was refused"))
        outbox_tends()

    monkeypatch.setattr(robot.bridge.outbox, "tend", tend)
    assert refused.wait(PATIENCE_S)
    robot.drive(0, 45)
    robot.until(robot.bridge.news)
    assert "the spool was refused" in caplog.text


def test_the_news_have_the_submaps_of_the_session(robot_in) -> None:
    robot, answers = robot_in(), []
    robot.drive(0, 45)

    def told() -> bool:
        answers.extend(news.answer for news in robot.bridge.news())
        return bool(answers) and len(answers[-1].submaps) >= 2

    robot.until(told)
    answer: Answer = answers[-1]
    assert answer.session == robot.session
    assert all(submap.name.startswith(f"{robot.session}/submaps/") for submap in answer.submaps)


def test_after_a_reboot_a_new_session_begins_and_the_old_one_is_sent_and_finished(robot_in) -> None:
    robot = robot_in(NOWHERE)
    robot.drive(0, 9)
    first = robot.session
    robot.off()
    robot = robot_in(boot="boot 2")
    robot.drive(0, 4)
    assert robot.session != first
    robot.until(lambda: robot.bridge.outbox.state.pending == 0 and len(robot.bridge.outbox.session_ids) == 1)
    old = robot.client.get_session(first)
    assert (old.committed_seq, old.state) == (10, "FINISHED")
    assert stored(robot) == 5


def test_a_node_that_starts_again_goes_on_with_its_session(robot_in) -> None:
    robot = robot_in()
    robot.drive(0, 9)
    first = robot.session
    robot.off()
    robot = robot_in()
    robot.drive(10, 14)
    assert robot.session == first
    robot.until(lambda: robot.bridge.outbox.state.pending == 0 and stored(robot) >= 15)
    assert stored(robot) == 15


def test_a_session_that_was_finished_elsewhere_is_followed_by_a_new_one(robot_in) -> None:
    robot = robot_in()
    robot.drive(0, 4)
    robot.until(lambda: robot.bridge.outbox.state.pending == 0)
    first = robot.session
    robot.client.finish_session(first)
    robot.drive(5, 6)
    robot.until(lambda: robot.bridge.outbox.lost is not None)
    robot.drive(7, 9)
    assert robot.session != first
    robot.until(lambda: robot.bridge.outbox.state.stuck == (first,))
    robot.until(lambda: stored(robot) == 3)


def test_a_cloud_that_is_damaged_costs_that_cloud_and_is_told(robot_in) -> None:
    robot = robot_in()
    robot.drive(0, 2)
    broken = robot.ros.cloud(cloud_points(3), 1000 * SECOND + 3 * SECOND // 10, "base_link")
    broken.width += 1
    robot.bridge.take_cloud(broken)
    robot.bridge.take_odometry(robot.ros.odometry(se3.from_yaw(0.0, (1.5, 0.0, 0.0)), 1000 * SECOND + 3 * SECOND // 10))
    assert "bytes" in robot.bridge.problem or "points" in robot.bridge.problem
    robot.drive(4, 6)
    robot.until(lambda: robot.bridge.outbox.state.pending == 0 and stored(robot) >= 6)
    assert robot.bridge.problem == ""


def test_registered_clouds_are_taken_back_to_the_sensor(robot_in) -> None:
    robot = robot_in(NOWHERE)
    pose, stamp = se3.from_yaw(0.7, (30.0, 2.0, 0.0)), 1000 * SECOND
    sent: list[np.ndarray] = []
    robot.bridge.outbox.send = lambda points, *_: sent.append(points)
    registered = se3.apply(pose, cloud_points(1).astype(float)).astype(np.float32)
    robot.bridge.take_odometry(robot.ros.odometry(np.eye(4), stamp - SECOND))
    robot.bridge.take_odometry(robot.ros.odometry(pose, stamp))
    robot.bridge.take_cloud(robot.ros.cloud(registered, stamp, "odom"))
    assert np.allclose(sent[0], cloud_points(1), atol=1e-4)


def test_a_session_is_created_with_the_storey_that_it_began_on_also_after_a_restart(robot_in) -> None:
    robot = robot_in(NOWHERE, storey="B2")
    robot.drive(0, 10)
    first = robot.session
    robot.off()

    again = robot_in(storey="B2")
    assert again.session == first  # the same storey: the session goes on
    again.off()

    upstairs = robot_in(storey="B1")
    assert upstairs.session == ""
    upstairs.drive(11, 20)
    upstairs.until(lambda: upstairs.bridge.outbox.state.pending == 0 and stored(upstairs) == 10)
    upstairs.until(lambda: upstairs.client.get_session(first).state == "FINISHED")
    assert upstairs.client.get_session(first).storey == "B2"
    assert upstairs.client.get_session(first).committed_seq == 11
    assert upstairs.client.get_session(upstairs.session).storey == "B1"


def test_fixes_of_a_drive_without_a_link_are_anchors_of_their_sessions_after_a_reboot(robot_in) -> None:
    robot = robot_in(NOWHERE)
    robot.drive(0, 9, fixes=True)
    first = robot.session
    assert robot.bridge.outbox.state.anchors_waiting == 5
    robot.off()
    robot = robot_in(boot="boot 2")
    assert robot.bridge.outbox.state.anchors_waiting == 5
    robot.drive(0, 4, fixes=True)
    robot.until(lambda: robot.bridge.outbox.state.anchors_waiting == 0 and len(robot.bridge.outbox.session_ids) == 1)
    robot.until(lambda: robot.client.get_session(first).state == "FINISHED")
    kept = robot.client.sessions.anchors(first)
    assert [(one.kind, one.T_odom_sensor[0, 3]) for one in kept] == [("GNSS", pytest.approx(x)) for x in range(5)]
    assert len(robot.client.sessions.anchors(robot.session)) == 3
    assert robot.bridge.outbox.state.anchors_stored == 8 and robot.bridge.problem == ""


def test_a_point_that_somebody_names_is_an_anchor_at_once_and_a_second_one_of_its_id_is_told(robot_in, caplog) -> None:
    robot = robot_in()
    robot.drive(0, 2)
    for place in ((1.0, 2.0, 3.0), (1.0, 2.0, 4.0)):
        assert robot.bridge.add_anchor(robot.ros.add_anchor("door-7", (4.0, 0.0, 0.0), local_m=place))[0]
    robot.until(lambda: robot.bridge.outbox.state.anchors_waiting == 0)
    (door,) = robot.client.sessions.anchors(robot.session)
    assert (door.kind, door.local_m, door.offset_m) == ("CONTROL_POINT", (1.0, 2.0, 3.0), (4.0, 0.0, 0.0))
    assert robot.bridge.outbox.state.anchors_lost == 1 and "anchor door-7 of" in caplog.text
