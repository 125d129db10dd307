"""Bags as real robots record them, written by an independent library: each is read right or refused with advice.

A recording is right where every scan, moved by its pose, lies on the one world that all of them saw.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer

from revisit.cli.recordings import opened
from revisit.core.errors import BadField, RevisitError, UnsupportedEncoding
from revisit.core.geometry import se3
from revisit.evaluation.datasets import WantedTopics, notes_of, open_bag, open_recording

pytest.importorskip("rosbags", reason="in the extra `dev`: writes the bags")

START_NS = 1_700_000_000 * 10**9
SCANS = 8
PERIOD_NS = 100_000_000
WORLD = np.random.default_rng(5).uniform(-20, 20, (300, 3))
MOUNTED = se3.from_yaw(np.pi / 2, (0.9, 0.1, 1.8))
TWIST = np.array([1.5, 0.2, 0.0, 0.0, 0.0, 0.6])


def body_at(stamp_ns: int) -> np.ndarray:
    """T_odom_body at a time, on a screw motion."""
    return se3.from_yaw(0.4, (3.0, -2.0, 0.0)) @ se3.exp(TWIST * (stamp_ns - START_NS) / 1e9)


def scan_stamps() -> list[int]:
    return [START_NS + index * PERIOD_NS for index in range(SCANS)]


def pose_stamps() -> list[int]:
    """Between the scans, from before the first to behind the last."""
    return [START_NS + index * PERIOD_NS - 37_000_000 for index in range(SCANS + 1)]


@dataclass
class Layout:
    """What a bag holds: rows of (time, topic, type, message)."""

    ros1: bool = False
    rows: list[tuple[int, str, str, object]] = field(default_factory=list)

    def __post_init__(self) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            transforms = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
        self.types = self.store.types

    def header(self, stamp_ns: int, frame: str) -> object:
        time = self.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        sequence = {"seq": 7} if self.ros1 else {}
        return self.types["std_msgs/msg/Header"](**sequence, stamp=time, frame_id=frame)

    def clouds(self, topic: str, frame: str, T_frame_world) -> Layout:
        for stamp in scan_stamps():
            self.rows.append(
                (stamp, topic, "sensor_msgs/msg/PointCloud2", self._cloud(stamp, frame, T_frame_world(stamp)))
            )
        return self

    def _cloud(self, stamp: int, frame: str, T_frame_world: np.ndarray) -> object:
        points = se3.apply(T_frame_world, WORLD).astype("<f4")
        kinds = [
            self.types["sensor_msgs/msg/PointField"](name=name, offset=4 * index, datatype=7, count=1)
            for index, name in enumerate("xyz")
        ]
        return self.types["sensor_msgs/msg/PointCloud2"](
            header=self.header(stamp, frame), height=1, width=len(points), fields=kinds, is_bigendian=False,
            point_step=12, row_step=12 * len(points), data=np.frombuffer(points.tobytes(), np.uint8), is_dense=True,
        )  # fmt: skip

    def raw(self, topic: str, frame: str, mounted: np.ndarray | None = None) -> Layout:
        """Clouds of a sensor that sits on the body."""
        T_body_sensor = np.eye(4) if mounted is None else mounted
        return self.clouds(topic, frame, lambda stamp: se3.inverse(body_at(stamp) @ T_body_sensor))

    def odometry(self, topic: str, frame: str, child: str) -> Layout:
        for stamp in pose_stamps():
            pose = self._with_covariance("PoseWithCovariance", pose=self._pose(body_at(stamp)))
            zeros = self._vector(np.zeros(3))
            twist = self.types["geometry_msgs/msg/Twist"](linear=zeros, angular=zeros)
            message = self.types["nav_msgs/msg/Odometry"](
                header=self.header(stamp, frame), child_frame_id=child, pose=pose,
                twist=self._with_covariance("TwistWithCovariance", twist=twist),
            )  # fmt: skip
            self.rows.append((stamp, topic, "nav_msgs/msg/Odometry", message))
        return self

    def _with_covariance(self, name: str, **content: object) -> object:
        return self.types[f"geometry_msgs/msg/{name}"](**content, covariance=np.zeros(36))

    def poses(self, topic: str, frame: str) -> Layout:
        for stamp in pose_stamps():
            message = self.types["geometry_msgs/msg/PoseStamped"](
                header=self.header(stamp, frame), pose=self._pose(body_at(stamp))
            )
            self.rows.append((stamp, topic, "geometry_msgs/msg/PoseStamped", message))
        return self

    def _pose(self, transform: np.ndarray) -> object:
        point = self.types["geometry_msgs/msg/Point"](*transform[:3, 3])
        return self.types["geometry_msgs/msg/Pose"](position=point, orientation=self._quaternion(transform))

    def _quaternion(self, transform: np.ndarray) -> object:
        return self.types["geometry_msgs/msg/Quaternion"](*se3.to_quaternion(transform))

    def _vector(self, values: np.ndarray) -> object:
        return self.types["geometry_msgs/msg/Vector3"](*values)

    def transform(self, parent: str, child: str, T_parent_child, *, moving: bool) -> Layout:
        for stamp in pose_stamps() if moving else [START_NS]:
            matrix = T_parent_child(stamp) if moving else T_parent_child
            stamped = self.types["geometry_msgs/msg/TransformStamped"](
                header=self.header(stamp, parent), child_frame_id=child,
                transform=self.types["geometry_msgs/msg/Transform"](
                    translation=self._vector(matrix[:3, 3]), rotation=self._quaternion(matrix)
                ),
            )  # fmt: skip
            message = self.types["tf2_msgs/msg/TFMessage"](transforms=[stamped])
            self.rows.append((stamp, "/tf" if moving else "/tf_static", "tf2_msgs/msg/TFMessage", message))
        return self

    def text(self, topic: str) -> Layout:
        self.rows.append((START_NS, topic, "std_msgs/msg/String", self.types["std_msgs/msg/String"](data="hello")))
        return self

    def write2(self, folder: Path, plugin: str = "MCAP", *, zstd: bool = False) -> Path:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

        writer = Writer(folder, version=9, storage_plugin=StoragePlugin[plugin])
        if zstd:
            writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
        with writer:
            self._write(writer, self.store.serialize_cdr)
        return folder

    def write1(self, file: Path, compression: str | None = None) -> Path:
        from rosbags.rosbag1 import Writer

        writer = Writer(file)
        if compression is not None:
            writer.set_compression(Writer.CompressionFormat[compression])
        with writer:
            self._write(writer, self.store.serialize_ros1)
        return file

    def _write(self, writer, serialize) -> None:
        connections: dict[str, object] = {}
        for stamp, topic, kind, message in sorted(self.rows, key=lambda row: row[0]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
            writer.write(connections[topic], stamp, serialize(message, kind))


def deviation(recording) -> float:
    """How far scans that were moved by their poses lie from the world, metres."""
    moved = [se3.apply(scan.T_odom_sensor, scan.points.astype(float)) for scan in recording]
    return max(float(np.abs(points - WORLD).max()) for points in moved)


def fast_lio() -> Layout:
    registered = Layout().clouds("/cloud_registered", "camera_init", lambda stamp: np.eye(4))
    return registered.raw("/livox/lidar", "livox_frame").odometry("/Odometry", "camera_init", "body")


def lio_sam() -> Layout:
    layout = Layout().clouds("/lio_sam/mapping/cloud_registered", "odom", lambda stamp: np.eye(4))
    layout.raw("/points_raw", "velodyne", MOUNTED).odometry("/lio_sam/mapping/odometry", "odom", "base_link")
    return layout.transform("base_link", "velodyne", MOUNTED, moving=False).text("/chatter")


def kiss_icp() -> Layout:
    layout = Layout().raw("/points", "os_lidar", MOUNTED).odometry("/kiss/odometry", "odom_lidar", "base_link")
    layout.transform("base_link", "os_sensor", MOUNTED @ se3.from_yaw(-0.3), moving=False)
    return layout.transform("os_sensor", "os_lidar", se3.from_yaw(0.3), moving=False)


def nuscenes_like() -> Layout:
    """No odometry: transforms alone, those of the sensors repeated on /tf."""
    layout = Layout().raw("/LIDAR_TOP", "LIDAR_TOP", MOUNTED).transform("map", "base_link", body_at, moving=True)
    return layout.transform("base_link", "LIDAR_TOP", lambda stamp: MOUNTED, moving=True)


def tf_only() -> Layout:
    """map -> odom jumps, odom -> base_link does not: scans get the smooth pose."""
    layout = Layout().raw("/scan", "laser", MOUNTED).transform("odom", "base_link", body_at, moving=True)
    layout.transform("map", "odom", lambda stamp: se3.from_yaw(0.1 * (stamp // 10**8 % 3)), moving=True)
    return layout.transform("base_link", "laser", MOUNTED, moving=False)


def registered_only() -> Layout:
    registered = Layout().clouds("/cloud_registered", "odom", lambda stamp: np.eye(4))
    return registered.odometry("/Odometry", "odom", "body")


def registered_in_a_map() -> Layout:
    """Clouds in a map whose transform to the frame of the odometry is known."""
    T_map_odom = se3.from_yaw(1.0, (5.0, 5.0, 0.0))
    layout = Layout().clouds("/cloud_in_map", "map", lambda stamp: T_map_odom)
    return layout.odometry("/odom", "odom", "base").transform("map", "odom", T_map_odom, moving=False)


def registered_in_the_body() -> Layout:
    return fast_lio().raw("/cloud_registered_body", "body")


def two_lidars() -> Layout:
    front, rear = MOUNTED, se3.from_yaw(np.pi, (-1.0, 0.0, 1.0))
    layout = Layout().raw("/front/points", "front", front).raw("/rear/points", "rear", rear)
    layout.odometry("/odom", "odom", "base_link").transform("base_link", "front", front, moving=False)
    return layout.transform("base_link", "rear", rear, moving=False)


def pose_stamped() -> Layout:
    return Layout().raw("/points", "lidar").poses("/slam/pose", "map")


def slashed_frames() -> Layout:
    return Layout().clouds("/registered", "/odom", lambda stamp: np.eye(4)).odometry("/odom", "odom", "base")


LAYOUTS = {
    fast_lio: "/livox/lidar",
    lio_sam: "/points_raw",
    kiss_icp: "/points",
    nuscenes_like: "/LIDAR_TOP",
    tf_only: "/scan",
    registered_only: "/cloud_registered",
    registered_in_a_map: "/cloud_in_map",
    registered_in_the_body: "/cloud_registered_body",
    two_lidars: "/front/points",
    pose_stamped: "/points",
    slashed_frames: "/registered",
}


@pytest.mark.parametrize("plugin", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.__name__)
def test_every_scan_lies_on_the_world_and_the_topic_is_told(tmp_path: Path, layout, plugin: str) -> None:
    recording = open_recording(layout().write2(tmp_path / "drive", plugin))
    assert len(recording) == SCANS
    assert deviation(recording) < 1e-4
    assert notes_of(recording)[0].startswith(f"clouds of {LAYOUTS[layout]} (frame ")


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.__name__)
def test_every_scan_is_in_the_frame_of_its_sensor(tmp_path: Path, layout) -> None:
    # Right on the world is not enough: a registered cloud with the identity for its pose is that, too.
    recording = open_bag(layout().write2(tmp_path / "drive"))
    travelled = recording.pose(SCANS - 1)[:3, 3] - recording.pose(0)[:3, 3]
    assert 0.5 < np.linalg.norm(travelled) < 2.0


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_bags_of_ros_1_are_read(tmp_path: Path, compression: str | None) -> None:
    layout = Layout(ros1=True).raw("/velodyne_points", "/velodyne", MOUNTED).odometry("/odom", "/odom", "/base_link")
    layout.transform("/base_link", "/velodyne", MOUNTED, moving=False)
    recording = open_recording(layout.write1(tmp_path / "drive.bag", compression))
    assert len(recording) == SCANS and deviation(recording) < 1e-4


@pytest.mark.parametrize("plugin", ["MCAP", "SQLITE3"])
def test_a_split_bag_is_read_as_one(tmp_path: Path, plugin: str) -> None:
    whole = fast_lio()
    middle = START_NS + 4 * PERIOD_NS - 1
    suffix = {"MCAP": "mcap", "SQLITE3": "db3"}[plugin]
    (tmp_path / "drive").mkdir()
    for number, part in enumerate((lambda row: row[0] < middle, lambda row: row[0] >= middle)):
        half = Layout(rows=[row for row in whole.rows if part(row)]).write2(tmp_path / f"half{number}", plugin)
        (half / f"half{number}.{suffix}").rename(tmp_path / "drive" / f"part_{number}.{suffix}")
    listed = f"  relative_file_paths:\n    - part_0.{suffix}\n    - part_1.{suffix}\n  duration:\n"
    (tmp_path / "drive/metadata.yaml").write_text(f"rosbag2_bagfile_information:\n{listed}")
    recording = open_recording(tmp_path / "drive")
    assert len(recording) == SCANS and deviation(recording) < 1e-4
    assert "2 files read as one recording" in notes_of(recording)


def test_what_is_wanted_is_taken(tmp_path: Path) -> None:
    bag = two_lidars().odometry("/other", "odom", "base_link").write2(tmp_path / "drive")
    recording = open_bag(bag, WantedTopics("/rear/points", "/other"))
    assert deviation(recording) < 1e-4
    told = " | ".join(notes_of(recording))
    assert "clouds of /rear/points" in told and "poses of /other" in told and "--topic" in told


def test_the_mounting_that_is_given_is_used(tmp_path: Path) -> None:
    bag = Layout().raw("/points", "lidar", MOUNTED).odometry("/odom", "odom", "base").write2(tmp_path / "drive")
    assert deviation(open_bag(bag)) > 0.5
    assert any("--T-body-sensor" in note for note in notes_of(open_bag(bag)))
    assert deviation(open_bag(bag, WantedTopics(T_body_sensor=MOUNTED))) < 1e-4


REFUSED = {
    "no odometry": (lambda: Layout().raw("/points", "lidar"), {}, "KISS-ICP"),
    "no clouds": (lambda: Layout().odometry("/odom", "odom", "base"), {}, "no sensor_msgs/PointCloud2.*nav_msgs"),
    "no such topic": (two_lidars, {"topic": "/left"}, "/front/points, /rear/points"),
    "no such odometry": (two_lidars, {"odometry": "/wheels"}, "topics with poses: /odom"),
    "transforms that do not move": (
        lambda: Layout().raw("/points", "lidar").transform("base", "lidar", MOUNTED, moving=False),
        {"odometry": "/tf"},
        "do not tell how lidar moves",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_read_is_refused_with_advice(tmp_path: Path, case: str) -> None:
    layout, wanted, advice = REFUSED[case]
    with pytest.raises(BadField, match=advice):
        open_bag(layout().write2(tmp_path / "drive"), WantedTopics(**wanted))


@pytest.mark.parametrize("compression", [None, "BZ2"])
def test_a_damaged_bag_of_ros_1_costs_no_more_than_a_refusal(tmp_path: Path, compression: str | None) -> None:
    layout = Layout(ros1=True).raw("/points", "lidar").odometry("/odom", "odom", "base")
    sound = layout.write1(tmp_path / "sound.bag", compression).read_bytes()
    random, refused = np.random.default_rng(3), 0
    for cut in random.integers(13, len(sound), 40):
        damaged = bytearray(sound if cut % 2 else sound[:cut])
        damaged[min(int(cut), len(damaged) - 1)] ^= 0xFF
        (tmp_path / "damaged.bag").write_bytes(damaged)
        try:
            list(open_bag(tmp_path / "damaged.bag"))
        except RevisitError:
            refused += 1
    assert refused > 10


def test_two_drives_in_one_folder_are_not_mixed(tmp_path: Path) -> None:
    Layout(ros1=True).raw("/points", "lidar").write1(tmp_path / "monday.bag")
    Layout(ros1=True).raw("/points", "lidar").write1(tmp_path / "tuesday.bag")
    with pytest.raises(BadField, match="2 bags"):
        open_bag(tmp_path)


def test_messages_that_are_compressed_one_by_one_are_refused_with_the_way_out(tmp_path: Path) -> None:
    with pytest.raises(UnsupportedEncoding, match="ros2 bag convert"):
        open_bag(fast_lio().write2(tmp_path / "drive", "SQLITE3", zstd=True))


def test_a_driver_s_own_clouds_are_refused_with_the_setting_to_change() -> None:
    from revisit.evaluation.datasets.topic_choice import choose

    found = SimpleNamespace(clouds={}, types={"/livox/lidar": "livox_ros_driver2/msg/CustomMsg"})
    with pytest.raises(BadField, match="xfer_format 0"):
        choose(found, WantedTopics())  # type: ignore[arg-type]


def test_a_command_says_on_stderr_which_topics_it_took_and_why(tmp_path: Path, capsys) -> None:
    bag = fast_lio().write2(tmp_path / "drive")
    assert len(opened(bag, "auto", None, None, "0 0 0 0 0 0 1")) == SCANS
    said = capsys.readouterr()
    assert said.out == ""
    assert "clouds of /livox/lidar (frame livox_frame), 8 of 8 with a pose" in said.err
    assert "poses of /Odometry (frame camera_init, following body)" in said.err
    assert "not used: /cloud_registered; --topic chooses" in said.err


@pytest.mark.parametrize("mounting", ["1 2 3", "1 2 3 0 0 0 one"])
def test_a_mounting_is_seven_numbers(tmp_path: Path, capsys, mounting: str) -> None:
    with pytest.raises(typer.Exit):
        opened(tmp_path, "auto", None, None, mounting)
    assert "x y z qx qy qz qw" in capsys.readouterr().err
