"""What the ROS 2 bridge makes of clouds, odometry and TF, with messages that went through CDR."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="in the extra `dev`: gives the messages' types")

from revisit_bridge.bridge import Bridge
from revisit_bridge.messages import cloud_of, points_of, pose_of, received
from revisit_bridge.pairing import OdometryPoses, TransformPoses, Unknown, WaitingClouds
from revisit_bridge.parameters import Parameters

from revisit.core.errors import BadTransform, RevisitError
from revisit.core.geometry import se3
from tests.support.bag_layouts import Layout
from tests.support.ros_messages import Messages

SECOND = 10**9
MOUNTED = se3.from_yaw(np.pi / 2, (0.9, 0.1, 1.8))
TWIST = np.array([1.5, 0.2, 0.0, 0.0, 0.0, 0.6])


@pytest.fixture(scope="module")
def ros():
    return Messages()


def body_at(stamp_ns: int) -> np.ndarray:
    return se3.exp(TWIST * stamp_ns / SECOND)


def mounted(target: str, source: str, stamp: int):
    return MOUNTED if (target, source) == ("base_link", "lidar") else Unknown.NOT_YET


@pytest.mark.parametrize("layout", [{}, {"rows": 4}, {"rows": 4, "padding": 7}, {"big": True}], ids=str)
def test_points_are_read_whatever_the_layout(ros, layout) -> None:
    points = np.random.default_rng(1).uniform(-30, 30, (400, 3)).astype(np.float32)
    assert np.array_equal(points_of(ros.cloud(points, SECOND, "lidar", **layout)), points)


def test_intensity_is_read_where_it_is_asked_for(ros) -> None:
    points, told = np.arange(18, dtype=np.float32).reshape(6, 3) - 3.0, np.arange(6, dtype=np.float32)
    points[1] = 0.0
    cloud = ros.cloud(points, SECOND, "lidar", intensity=told)
    assert points_of(cloud).shape == (5, 3)
    kept = [0, 2, 3, 4, 5]
    found = cloud_of(cloud, None, ("intensity", "ring"))
    assert np.array_equal(found.points, points[kept]) and np.array_equal(found.columns["intensity"], told[kept])


@pytest.mark.parametrize("wrong", [None, 0.0, -1.0, np.nan, 7e4], ids=str)
def test_an_intensity_that_cannot_be_used_costs_no_scan(ros, wrong) -> None:
    told = None if wrong is None else np.full(6, wrong, np.float32)
    found = cloud_of(ros.cloud(np.ones((6, 3)), SECOND, "lidar", intensity=told), None, ("intensity",))
    assert found.points.shape == (6, 3) and not found.columns


def test_points_that_did_not_come_back_are_left_out(ros) -> None:
    points = np.ones((6, 3), np.float32)
    points[1], points[2, 1], points[3] = 0.0, np.nan, np.inf
    assert len(points_of(ros.cloud(points, SECOND, "lidar"))) == 3


def test_a_cloud_that_holds_less_than_it_says_is_refused(ros) -> None:
    cloud = ros.cloud(np.ones((6, 3), np.float32), SECOND, "lidar")
    cloud.width = 7
    with pytest.raises(RevisitError):
        points_of(cloud)
    cloud.height, cloud.row_step = 2, 0
    with pytest.raises(RevisitError):
        points_of(cloud)


def test_a_pose_is_read_with_frames_as_tf_names_them(ros) -> None:
    pose = pose_of(ros.odometry(body_at(SECOND), 5 * SECOND + 7, "/odom", "/base_link"))
    assert (pose.stamp_ns, pose.parent, pose.child) == (5 * SECOND + 7, "odom", "base_link")
    assert np.allclose(pose.T_parent_child, body_at(SECOND))


def test_an_odometry_that_has_not_started_is_refused(ros) -> None:
    message = ros.odometry(np.eye(4), SECOND)
    message.pose.pose.orientation.w = 0.0
    with pytest.raises(BadTransform):
        pose_of(message)


def odometry_at(ros, *tenths: int) -> OdometryPoses:
    poses = OdometryPoses(mounted)
    for tenth in tenths:
        poses.take(pose_of(ros.odometry(body_at(tenth * SECOND // 10), tenth * SECOND // 10)))
    return poses


def test_a_pose_between_two_messages_lies_on_the_screw_between_them(ros) -> None:
    poses = odometry_at(ros, 1, 2, 3)
    stamp = 137_000_000
    assert np.allclose(poses.sensor_pose("base_link", stamp), body_at(stamp), atol=1e-9)
    assert np.allclose(poses.sensor_pose("lidar", stamp), body_at(stamp) @ MOUNTED, atol=1e-9)


def test_a_pose_is_not_yet_known_or_never_again(ros) -> None:
    poses = odometry_at(ros, 1, 2)
    assert poses.sensor_pose("base_link", 3 * SECOND // 10) is Unknown.NOT_YET
    assert poses.sensor_pose("base_link", SECOND // 20) is Unknown.NEVER
    assert poses.sensor_pose("a_frame_nobody_told", 15 * SECOND // 100) is Unknown.NOT_YET
    assert OdometryPoses(mounted).sensor_pose("base_link", SECOND) is Unknown.NOT_YET


def test_odometry_that_starts_anew_forgets_what_was_before(ros) -> None:
    poses = odometry_at(ros, 500, 501, 3, 4)
    assert poses.sensor_pose("base_link", 501 * SECOND // 10) is Unknown.NOT_YET
    assert np.allclose(poses.sensor_pose("base_link", 4 * SECOND // 10), body_at(4 * SECOND // 10))


def test_a_message_that_comes_late_changes_nothing(ros) -> None:
    poses = odometry_at(ros, 10, 12, 11)
    assert np.allclose(poses.sensor_pose("base_link", 12 * SECOND // 10), body_at(12 * SECOND // 10))


def test_the_history_is_bounded(ros) -> None:
    poses = odometry_at(ros, *range(0, 400, 5))
    assert len(poses._poses) <= 21


def sweep(ros, stamp: int, timed: bool = True):
    """World points (n, 3), and the cloud that a sensor on the body has of them, which moves meanwhile."""
    world, offsets = np.random.default_rng(4).uniform(-30, 30, (300, 3)), np.arange(300) * 300_000
    taken = zip(offsets, world, strict=True)
    seen = np.array([se3.inverse(body_at(stamp + ns))[:3] @ [*point, 1.0] for ns, point in taken])
    cloud = ros.cloud(seen.astype(np.float32), stamp, "base_link", offsets_ns=offsets if timed else None)
    return se3.apply(se3.inverse(body_at(stamp)), world), cloud


def test_points_with_times_are_moved_to_the_stamp_once_the_poses_are_there(ros) -> None:
    at_once, cloud = sweep(ros, 2 * SECOND // 10)
    poses = odometry_at(ros, 1, 2)
    waiting = WaitingClouds(poses, wait_s=2.0, max_waiting=3, now_s=lambda: 0.0, deskew=True)
    waiting.take(cloud)
    assert waiting.ready() == []
    poses.take(pose_of(ros.odometry(body_at(3 * SECOND // 10), 3 * SECOND // 10)))
    (posed,) = waiting.ready()
    assert np.abs(points_of(posed.cloud, posed.motion) - at_once).max() < 2e-3
    assert np.abs(points_of(posed.cloud) - at_once).max() > 0.3


def test_points_without_times_do_not_wait_for_more_than_their_pose(ros) -> None:
    waiting = WaitingClouds(odometry_at(ros, 1, 2), 2.0, max_waiting=3, now_s=lambda: 0.0, deskew=True)
    waiting.take(sweep(ros, 2 * SECOND // 10, timed=False)[1])
    assert [posed.motion for posed in waiting.ready()] == [None]


def test_a_cloud_whose_last_poses_do_not_come_is_handed_on_as_it_is(ros) -> None:
    clock = [0.0]
    waiting = WaitingClouds(odometry_at(ros, 1, 2), 2.0, max_waiting=3, now_s=lambda: clock[0], deskew=True)
    waiting.take(sweep(ros, 2 * SECOND // 10)[1])
    assert waiting.ready() == []
    clock[0] = 3.0
    (posed,) = waiting.ready()
    assert posed.motion is None and waiting.left_out == 0


def test_clouds_wait_for_their_pose_and_keep_their_order(ros) -> None:
    clock, poses = [0.0], odometry_at(ros, 1)
    clouds = WaitingClouds(poses, wait_s=2.0, max_waiting=3, now_s=lambda: clock[0])
    for tenth in (2, 3):
        clouds.take(ros.cloud(np.ones((4, 3), np.float32), tenth * SECOND // 10, "lidar"))
    assert clouds.ready() == []
    poses.take(pose_of(ros.odometry(body_at(SECOND // 4), SECOND // 4)))
    (first,) = clouds.ready()
    assert first.stamp_ns == SECOND // 5 and np.allclose(first.T_odom_sensor, body_at(SECOND // 5) @ MOUNTED)
    poses.take(pose_of(ros.odometry(body_at(SECOND // 2), SECOND // 2)))
    assert [posed.stamp_ns for posed in clouds.ready()] == [3 * SECOND // 10]
    assert clouds.left_out == 0


def test_a_cloud_without_a_pose_is_left_out_in_time_and_counted(ros) -> None:
    clock = [0.0]
    clouds = WaitingClouds(TransformPoses("odom", mounted), wait_s=2.0, max_waiting=3, now_s=lambda: clock[0])
    for stamp in range(5):
        clouds.take(ros.cloud(np.ones((4, 3), np.float32), stamp + 1, "lidar"))
    assert clouds.left_out == 2  # there was no room for them
    clock[0] = 2.1
    assert clouds.ready() == [] and clouds.left_out == 5


def livox(points: np.ndarray, stamp: int, offsets_ns: np.ndarray):
    """A CustomMsg of Livox's driver."""
    store = Layout().livox("/livox").store
    point, cloud = (store.types[f"livox_ros_driver2/msg/{name}"] for name in ("CustomPoint", "CustomMsg"))
    rows = [
        point(int(offset), *row, reflectivity=index % 256, tag=16, line=index % 4)
        for index, (offset, row) in enumerate(zip(offsets_ns, points, strict=True))
    ]
    header = Messages().header(stamp, "base_link")
    return cloud(header, timebase=stamp, point_num=len(rows), lidar_id=1, rsvd=np.zeros(3, np.uint8), points=rows)


def test_clouds_of_livox_are_read_and_deskewed(ros) -> None:
    stamp = 2 * SECOND // 10
    at_once, cloud = sweep(ros, stamp)
    seen = points_of(cloud)
    message = received(livox(seen, stamp, np.arange(300) * 300_000))
    read = cloud_of(message, columns=("intensity", "ring"))
    assert np.array_equal(read.points, seen)
    assert read.columns["intensity"][:3].tolist() == [0, 1, 2] and read.columns["ring"][:5].tolist() == [0, 1, 2, 3, 0]
    waiting = WaitingClouds(odometry_at(ros, 1, 2, 3), 2.0, max_waiting=3, now_s=lambda: 0.0, deskew=True)
    waiting.take(message)
    (posed,) = waiting.ready()
    assert np.abs(points_of(posed.cloud, posed.motion) - at_once).max() < 2e-3


class SentScans(list):
    """An outbox that keeps the points of the scans that it is given."""

    lost, session_ids = None, frozenset()

    def resume(self, _session_id: str) -> bool:
        return False

    def begin(self, _session_id: str) -> None:
        pass

    def close(self) -> None:
        pass

    def keep(self, _anchor: object) -> None:
        pass

    def send(self, points: np.ndarray, *_: object) -> None:
        self.append(points)


@pytest.mark.parametrize(
    ("asked", "sent_too"),
    [({}, set()), ({"intensity": True}, {"intensity"}), ({"columns": "time, intensity"}, {"intensity", "time"})],
)
def test_the_bridge_sends_the_columns_that_the_parameters_ask_for(ros, tmp_path, asked, sent_too) -> None:
    own, sent = Parameters(odometry_topic="odometry", **asked), SentScans()
    bridge = Bridge(own, mounted, sent, None, "boot", tmp_path / "last.json", lambda: 0.0)
    took = np.linspace(0, 9e7, 50).astype(np.uint32)
    for stamp, of_frame in ((SECOND, "lidar"), (2 * SECOND, "odom")):  # of the sensor, and registered by odometry
        bridge.take_cloud(ros.cloud(np.ones((50, 3)), stamp, of_frame, offsets_ns=took, intensity=np.full(50, 9.0)))
        for at in (stamp, stamp + 10**8):  # to the last point
            bridge.take_odometry(ros.odometry(se3.from_yaw(0.0, (1.0, 0.0, 0.0)), at))
    assert [set(getattr(one, "columns", {})) for one in sent] == 2 * [sent_too]
    points = getattr(sent[1], "points", sent[1])
    assert points.shape == (50, 3) and np.unique(points[:, 0]) == [0.0]
    assert "time" not in sent_too or np.array_equal(sent[1].columns["time"], took)
    bridge.close()


def test_a_column_that_no_point_has_is_no_parameter() -> None:
    with pytest.raises(ValueError, match="columns are of intensity, ring, time, rgb, got speed"):
        Parameters(columns="ring,speed")
