"""ROS 2 messages without ROS: types of the library `rosbags`, and those of `ros/revisit_msgs`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from revisit.core.geometry import se3

MSG_FOLDER = Path(__file__).resolve().parents[2] / "ros/revisit_msgs/msg"
_STANDARD = (
    "builtin_interfaces/msg/Time", "std_msgs/msg/Header", "geometry_msgs/msg/Point", "geometry_msgs/msg/Vector3",
    "geometry_msgs/msg/Quaternion", "geometry_msgs/msg/Pose", "geometry_msgs/msg/PoseWithCovariance",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/Transform", "geometry_msgs/msg/TransformStamped", "diagnostic_msgs/msg/KeyValue",
    "diagnostic_msgs/msg/DiagnosticStatus", "diagnostic_msgs/msg/DiagnosticArray", "nav_msgs/msg/MapMetaData",
    "nav_msgs/msg/OccupancyGrid",
)  # fmt: skip
SERVICES = ("AddAnchor",)
OWN = ("LoopClosure", "PoseGraphNode", "PoseGraph")


def ros_store():
    """The types of ROS 2 Humble with our own."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name in ("LoopClosure", "PoseGraphNode", "PoseGraph"):
        text = (MSG_FOLDER / f"{name}.msg").read_text()
        store.register(get_types_from_msg(text, f"revisit_msgs/msg/{name}"))
    for service in SERVICES:
        asked, answered = (MSG_FOLDER.parent / f"srv/{service}.srv").read_text().split("\n---\n")
        store.register(get_types_from_msg(asked, f"revisit_msgs/msg/{service}_Request"))
        store.register(get_types_from_msg(answered, f"revisit_msgs/msg/{service}_Response"))
    return store


def message_classes(store) -> dict[str, type]:
    """The classes that the bridge makes messages of, by their short names."""
    names = [*_STANDARD, *(f"revisit_msgs/msg/{name}" for name in OWN)]
    return {name.rpartition("/")[2]: store.types[name] for name in names}


class Messages:
    """Makes messages as a robot sends them."""

    def __init__(self) -> None:
        self.store = ros_store()
        self.types = self.store.types

    def header(self, stamp_ns: int, frame: str):
        time = self.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        return self.types["std_msgs/msg/Header"](stamp=time, frame_id=frame)

    def cloud(
        self, points: np.ndarray, stamp_ns: int, frame: str, *, rows: int = 1, padding: int = 0, big: bool = False,
        offsets_ns: np.ndarray | None = None, intensity: np.ndarray | None = None,
    ):  # fmt: skip
        """x, y, z, a time and an intensity where they are given, and a ring number a point, in `rows` rows with
        `padding` behind each.
        """
        order = ">" if big else "<"
        kind = np.dtype({"names": ["x", "y", "z", "t", "ring", "intensity"],
                         "formats": [f"{order}f4"] * 3 + [f"{order}u4", "u1", f"{order}f4"],
                         "offsets": [0, 4, 8, 12, 16, 20], "itemsize": 24})  # fmt: skip
        records = np.zeros(len(points), kind)
        if offsets_ns is not None:
            records["t"] = offsets_ns
        if intensity is not None:
            records["intensity"] = intensity
        for index, name in enumerate("xyz"):
            records[name] = points[:, index]
        width = len(points) // rows
        data = b"".join(records[row * width : (row + 1) * width].tobytes() + bytes(padding) for row in range(rows))
        field = self.types["sensor_msgs/msg/PointField"]
        fields = [field(name=name, offset=4 * index, datatype=7, count=1) for index, name in enumerate("xyz")]
        fields += [] if offsets_ns is None else [field(name="t", offset=12, datatype=6, count=1)]
        fields += [] if intensity is None else [field(name="intensity", offset=20, datatype=7, count=1)]
        message = self.types["sensor_msgs/msg/PointCloud2"](
            header=self.header(stamp_ns, frame), height=rows, width=width,
            fields=[*fields, field(name="ring", offset=16, datatype=2, count=1)], is_bigendian=big, point_step=24,
            row_step=24 * width + padding, data=np.frombuffer(data, np.uint8), is_dense=False,
        )  # fmt: skip
        return self.sent(message, "sensor_msgs/msg/PointCloud2")

    def odometry(self, pose: np.ndarray, stamp_ns: int, frame: str = "odom", child: str = "base_link"):
        named = {name.rpartition("/")[2]: kind for name, kind in self.types.items() if name.startswith("geometry_msgs")}
        x, y, z, w = se3.to_quaternion(pose)
        placed = named["Pose"](position=named["Point"](*pose[:3, 3]), orientation=named["Quaternion"](x, y, z, w))
        still = named["Twist"](linear=named["Vector3"](0.0, 0.0, 0.0), angular=named["Vector3"](0.0, 0.0, 0.0))
        message = self.types["nav_msgs/msg/Odometry"](
            header=self.header(stamp_ns, frame), child_frame_id=child,
            pose=named["PoseWithCovariance"](pose=placed, covariance=np.zeros(36)),
            twist=named["TwistWithCovariance"](twist=still, covariance=np.zeros(36)),
        )  # fmt: skip
        return self.sent(message, "nav_msgs/msg/Odometry")

    def fix(self, stamp_ns: int, frame: str, position=(48.1, 11.5, 520.0), status: int = 0, covariance=None):
        """A fix of satellites at (latitude, longitude, altitude)."""
        fixed = self.types["sensor_msgs/msg/NavSatStatus"](status=status, service=1)
        told = np.zeros(9) if covariance is None else np.ravel(covariance)
        message = self.types["sensor_msgs/msg/NavSatFix"](
            self.header(stamp_ns, frame), fixed, *position, told, 0 if covariance is None else 3
        )
        return self.sent(message, "sensor_msgs/msg/NavSatFix")

    def add_anchor(self, anchor_id: str, at, stamp_ns: int = 0, frame: str = "", **told: object):
        """A request that a point `at` in a frame of the robot has a known place."""
        point, vector = self.types["geometry_msgs/msg/Point"], self.types["geometry_msgs/msg/Vector3"]
        fields = {"on_earth": False, "latitude_deg": 0.0, "longitude_deg": 0.0, "altitude_m": 0.0,
                  "local_m": (0.0, 0.0, 0.0), "sigma_m": (0.02, 0.02, 0.05),
                  "heading_rad": 0.0, "heading_sigma_rad": 0.0, "tag": ""} | told  # fmt: skip
        fields |= {"local_m": point(*fields["local_m"]), "sigma_m": vector(*fields["sigma_m"])}
        seen = self.types["geometry_msgs/msg/PointStamped"](self.header(stamp_ns, frame), point(*at))
        kind = "revisit_msgs/msg/AddAnchor_Request"
        return self.sent(self.types[kind](anchor_id=anchor_id, point=seen, **fields), kind)

    def sent(self, message, kind: str):
        """The message as it arrives: written as CDR and read again."""
        return self.store.deserialize_cdr(bytes(self.store.serialize_cdr(message, kind)), kind)
