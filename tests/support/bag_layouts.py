"""Bags as robots record them, written by an independent library (`rosbags`)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from revisit.core.geometry import se3

START_NS = 1_700_000_000 * 10**9
SCANS = 8
PERIOD_NS = 100_000_000
WORLD = np.random.default_rng(5).uniform(-20, 20, (300, 3))
LIVOX_POINT = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
LIVOX_CLOUD = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nCustomPoint[] points"
)
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

    def clouds(self, topic: str, frame: str, T_frame_world, stamped=lambda stamp: stamp, organised=False) -> Layout:
        """`stamped` is what the driver writes into the header of a cloud that was taken at a time."""
        make = self._organised if organised else self._cloud
        for stamp in scan_stamps():
            cloud = make(stamped(stamp), frame, T_frame_world(stamp))
            self.rows.append((stamp, topic, "sensor_msgs/msg/PointCloud2", cloud))
        return self

    def _organised(self, stamp: int, frame: str, T_frame_world: np.ndarray) -> object:
        """Rows of a spinning sensor as float64, behind each of them padding; rays that did not come back are NaN."""
        points = np.full((2 * len(WORLD), 3), np.nan)
        points[::2] = se3.apply(T_frame_world, WORLD)
        kinds = [
            self.types["sensor_msgs/msg/PointField"](name=name, offset=8 * index + 4, datatype=8, count=1)
            for index, name in enumerate("xyz")
        ]
        record = np.dtype({"names": list("xyz"), "formats": ["<f8"] * 3, "offsets": [4, 12, 20], "itemsize": 32})
        rows = np.zeros((4, len(points) // 4), record)
        for index, name in enumerate("xyz"):
            rows[name] = points[:, index].reshape(4, -1)
        data = b"".join(row.tobytes() + b"\xff" * 6 for row in rows)
        return self.types["sensor_msgs/msg/PointCloud2"](
            header=self.header(stamp, frame), height=4, width=rows.shape[1], fields=kinds, is_bigendian=False,
            point_step=32, row_step=32 * rows.shape[1] + 6, data=np.frombuffer(data, np.uint8), is_dense=False,
        )  # fmt: skip

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

    def odometry(self, topic: str, frame: str, child: str, at=body_at, stamps: list[int] | None = None) -> Layout:
        """`at` is where the body is at a time."""
        for stamp in pose_stamps() if stamps is None else stamps:
            pose = self._with_covariance("PoseWithCovariance", pose=self._pose(at(stamp)))
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

    def _transform(self, matrix: np.ndarray) -> object:
        return self.types["geometry_msgs/msg/Transform"](
            translation=self._vector(matrix[:3, 3]), rotation=self._quaternion(matrix)
        )

    def _vector(self, values: np.ndarray) -> object:
        return self.types["geometry_msgs/msg/Vector3"](*values)

    def transform(self, parent: str, child: str, T_parent_child, *, moving: bool, namespace: str = "") -> Layout:
        for stamp in pose_stamps() if moving else [START_NS]:
            matrix = T_parent_child(stamp) if moving else T_parent_child
            stamped = self.types["geometry_msgs/msg/TransformStamped"](
                header=self.header(stamp, parent), child_frame_id=child,
                transform=self._transform(matrix),
            )  # fmt: skip
            message = self.types["tf2_msgs/msg/TFMessage"](transforms=[stamped])
            topic = f"{namespace}/{'tf' if moving else 'tf_static'}"
            self.rows.append((stamp, topic, "tf2_msgs/msg/TFMessage", message))
        return self

    def path(self, topic: str, frame: str) -> Layout:
        """The trajectory so far, again and again, as SLAM systems publish it."""
        placed = self.types["geometry_msgs/msg/PoseStamped"]
        poses = [placed(header=self.header(at, frame), pose=self._pose(body_at(at))) for at in pose_stamps()]
        for count in range(1, len(poses) + 1):
            stamp = pose_stamps()[count - 1]
            message = self.types["nav_msgs/msg/Path"](header=self.header(stamp, frame), poses=poses[:count])
            self.rows.append((stamp, topic, "nav_msgs/msg/Path", message))
        return self

    def tracked(self, topic: str, frame: str, child: str) -> Layout:
        """Poses of a motion capture."""
        for stamp in pose_stamps():
            transform = self._transform(body_at(stamp))
            message = self.types["geometry_msgs/msg/TransformStamped"](
                header=self.header(stamp, frame), child_frame_id=child, transform=transform
            )
            self.rows.append((stamp, topic, "geometry_msgs/msg/TransformStamped", message))
        return self

    def own_type(self, topic: str, kind: str, definition: str, **content: object) -> Layout:
        """Messages of a type that only its driver knows."""
        from rosbags.typesys import get_types_from_msg

        self.store.register(get_types_from_msg(definition, kind))
        for stamp in scan_stamps():
            message = self.store.types[kind](header=self.header(stamp, "lidar"), **content)
            self.rows.append((stamp, topic, kind, message))
        return self

    def flat_scans(self, topic: str) -> Layout:
        """Scans of a 2D scanner."""
        names = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")
        empty = np.zeros(0, np.float32)
        for stamp in scan_stamps():
            message = self.types["sensor_msgs/msg/LaserScan"](
                header=self.header(stamp, "laser"), **dict.fromkeys(names, 1.0), ranges=empty, intensities=empty
            )
            self.rows.append((stamp, topic, "sensor_msgs/msg/LaserScan", message))
        return self

    def livox(self, topic: str, frame: str = "lidar", package: str = "livox_ros_driver2") -> Layout:
        """Clouds in the message of Livox's own drivers, of a sensor that is the body."""
        from rosbags.typesys import get_types_from_msg

        point, cloud = f"{package}/msg/CustomPoint", f"{package}/msg/CustomMsg"
        self.store.register(get_types_from_msg(LIVOX_POINT, point))
        self.store.register(get_types_from_msg(LIVOX_CLOUD, cloud))
        for stamp in scan_stamps():
            seen = se3.apply(se3.inverse(body_at(stamp)), WORLD).astype(np.float32)
            points = [
                self.types[point](1000 * index, *row, reflectivity=index % 256, tag=16, line=index % 4)
                for index, row in enumerate(seen)
            ]
            message = self.types[cloud](
                header=self.header(stamp, frame), timebase=stamp, point_num=len(points), lidar_id=1,
                rsvd=np.zeros(3, np.uint8), points=points,
            )  # fmt: skip
            self.rows.append((stamp, topic, cloud, message))
        return self

    def fixes(self, topic: str, positions, status: int = 0, covariance=None) -> Layout:
        """Fixes of satellites while the scans were taken, at (latitude, longitude, altitude) by time."""
        told = np.zeros(9) if covariance is None else np.ravel(covariance)
        for stamp in scan_stamps():
            fixed = self.types["sensor_msgs/msg/NavSatStatus"](status=status, service=1)
            message = self.types["sensor_msgs/msg/NavSatFix"](
                self.header(stamp, "gps"), fixed, *positions(stamp), told, 0 if covariance is None else 3
            )
            self.rows.append((stamp, topic, "sensor_msgs/msg/NavSatFix", message))
        return self

    def text(self, topic: str) -> Layout:
        self.rows.append((START_NS, topic, "std_msgs/msg/String", self.types["std_msgs/msg/String"](data="hello")))
        return self

    def silent(self, topic: str, kind: str) -> Layout:
        """A topic that was recorded and on which nothing came."""
        self.rows.append((START_NS, topic, kind, None))
        return self

    def write2(self, folder: Path, plugin: str = "MCAP", *, compressed: str = "") -> Path:
        """`compressed` is "MESSAGE" or "FILE", by zstd."""
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

        writer = Writer(folder, version=9, storage_plugin=StoragePlugin[plugin])
        if compressed:
            writer.set_compression(CompressionMode[compressed], CompressionFormat.ZSTD)
        with writer:
            self._write(writer, self.store.serialize_cdr)
        return folder

    def write1(self, file: Path, compression: str | None = None, chunk_bytes: int = 1 << 20) -> Path:
        from rosbags.rosbag1 import Writer

        writer = Writer(file)
        writer.chunk_threshold = chunk_bytes
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
            if message is not None:
                writer.write(connections[topic], stamp, serialize(message, kind))


def back_in_time(layout: Layout, since_ns: int, by_ns: int) -> Layout:
    """The layout, the clock of its stamps set back at a time: all messages come in the same order as before."""
    for index, (at, topic, kind, message) in enumerate(layout.rows):
        if at >= since_ns:
            stamp = message.header.stamp
            total = stamp.sec * 10**9 + stamp.nanosec - by_ns
            header = replace(message.header, stamp=replace(stamp, sec=total // 10**9, nanosec=total % 10**9))
            layout.rows[index] = (at, topic, kind, replace(message, header=header))
    return layout


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


def alternating(right_is_known: bool = True) -> Layout:
    """Two LiDARs take turns on one topic."""
    left, right = MOUNTED, se3.from_yaw(-1.2, (1.0, -0.8, 1.0))
    turns = Layout().raw("/points", "left", left).rows[::2] + Layout().raw("/points", "right", right).rows[1::2]
    layout = Layout(rows=turns).odometry("/odom", "odom", "base_link")
    layout.transform("base_link", "left", left, moving=False)
    return layout.transform("base_link", "right", right, moving=False) if right_is_known else layout


def pose_stamped() -> Layout:
    return Layout().raw("/points", "lidar").poses("/slam/pose", "map")


def slashed_frames() -> Layout:
    return Layout().clouds("/registered", "/odom", lambda stamp: np.eye(4)).odometry("/odom", "odom", "base")
