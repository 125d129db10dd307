"""ROS messages as they lie in bags: clouds, poses and transforms, in the layout of ROS 2 (CDR) or of ROS 1."""

from __future__ import annotations

import struct
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField, MalformedBody
from revisit.core.geometry import se3
from revisit.core.point_columns import Columns
from revisit.core.scan import Points
from revisit.evaluation.datasets.bag_message import Encoding
from revisit.formats.cloud import TIME_FIELDS, CloudLimits, field_names
from revisit.formats.point_times import point_offsets, timed
from revisit.formats.pointcloud2 import (
    LIVOX_POINT,
    LIVOX_POINT_BYTES,
    PackedCloud,
    PointField,
    columns_of_points,
    decode_coordinates,
    decode_packed,
)
from revisit.formats.satellite_fix import SatelliteFix

LIVOX_TYPES = tuple(
    f"{package}/msg/CustomMsg" for package in ("livox_ros_driver2", "livox_ros_driver", "livox_interfaces")
)
CLOUD_TYPES = ("sensor_msgs/msg/PointCloud2", *LIVOX_TYPES)
ODOMETRY = "nav_msgs/msg/Odometry"
TRACKED = "geometry_msgs/msg/TransformStamped"
POSE_TYPES = (ODOMETRY, TRACKED, "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")
PATH_TYPES = ("nav_msgs/msg/Path",)
FIX_TYPES = ("sensor_msgs/msg/NavSatFix",)
TRANSFORM_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
MAX_FIELDS = 64
COORDINATES = ("x", "y", "z")
MAX_TRANSFORMS = 10_000
MAX_PATH_POSES = 10_000_000


@dataclass(frozen=True)
class Header:
    """When a message's content was measured, nanoseconds, and in which frame; no slash in front of its name."""

    stamp_ns: int
    frame: str


@dataclass(frozen=True)
class StampedTransform:
    """Where the frame `child` was in the frame `parent`. T_parent_child (4, 4); `child` is "" where nobody says it."""

    stamp_ns: int
    parent: str
    child: str
    T_parent_child: se3.Matrix4


class _Fields:
    """Reads values in turn: in CDR each aligned to its own size behind an encapsulation header, in ROS 1 packed."""

    def __init__(self, message: bytes, encoding: Encoding) -> None:
        self._aligned = encoding == "cdr"
        if self._aligned and (len(message) < 4 or message[0] != 0 or message[1] not in (0, 1)):
            raise MalformedBody("the message is no CDR")
        self._data = memoryview(message)[4 if self._aligned else 0 :]
        self._order = ">" if self._aligned and message[1] == 0 else "<"
        self._at = 0

    def number(self, code: str) -> float | int:
        """One value of a struct code."""
        return self.numbers(code, 1)[0]

    def numbers(self, code: str, count: int) -> tuple[float | int, ...]:
        """`count` values of a struct code."""
        size = struct.calcsize(f"={code}")
        if self._aligned:
            self._at += -self._at % size
        try:
            values = struct.unpack_from(f"{self._order}{count}{code}", self._data, self._at)
        except struct.error as error:
            raise MalformedBody("the message ends too early") from error
        self._at += size * count
        return values

    def raw(self) -> bytes:
        """A sequence of bytes, or a string, in CDR with its final zero."""
        return self.take(int(self.number("I")))

    def take(self, size: int) -> bytes:
        """The next `size` bytes."""
        if self._at + size > len(self._data):
            raise MalformedBody("the message ends too early")
        value = bytes(self._data[self._at : self._at + size])
        self._at += size
        return value

    @property
    def big_endian(self) -> bool:
        """Whether numbers begin with their highest byte."""
        return self._order == ">"

    def padding(self, size: int, alignment: int) -> int:
        """The bytes behind a value of `size` bytes up to the next multiple of `alignment`, where values are aligned."""
        return -size % alignment if self._aligned else 0

    def text(self) -> str:
        """A string."""
        return self.raw().rstrip(b"\0").decode("utf-8", errors="replace")

    def header(self) -> Header:
        """A std_msgs/Header; that of ROS 1 begins with a count."""
        if not self._aligned:
            self.number("I")
        seconds, nanoseconds = int(self.number("i")), int(self.number("I"))
        return Header(seconds * 10**9 + nanoseconds, self.frame())

    def frame(self) -> str:
        """The name of a frame."""
        return self.text().lstrip("/")

    def quaternion_pose(self) -> se3.Matrix4:
        """Position and quaternion (x, y, z, w). Raises BadTransform."""
        values = np.array(self.numbers("d", 7), dtype=np.float64)
        return se3.from_quaternion(values[3:], values[:3])


def read_header(message: bytes, encoding: Encoding = "cdr") -> Header:
    """The header of a message. Raises MalformedBody."""
    return _Fields(message, encoding).header()


@dataclass(frozen=True)
class Sweep:
    """A cloud whose points were taken one after the other: points (n, 3) float32, times (n,) since the stamp, ns."""

    points: Points
    offsets_ns: NDArray[np.int64]


def read_sweep(message: bytes, message_type: str, encoding: Encoding = "cdr") -> Sweep | None:
    """The points as `read_points` gives them, with their times; None where no field tells these."""
    stamp = read_header(message, encoding).stamp_ns
    offsets = point_offsets(_packed(message, message_type, encoding, (*COORDINATES, *TIME_FIELDS)), stamp)
    return None if offsets is None else Sweep(read_points(message, message_type, encoding), offsets)


def read_points(message: bytes, message_type: str, encoding: Encoding = "cdr") -> Points:
    """The points (n, 3) of a message of `CLOUD_TYPES`. Raises MalformedBody, BadField, TooLarge."""
    return decode_packed(_packed(message, message_type, encoding), CloudLimits()).points


def read_columns(message: bytes, message_type: str, wanted: Collection[str], encoding: Encoding = "cdr") -> Columns:
    """The columns of those points that are wanted and there; a time is that since the stamp of the message, ns."""
    packed = _packed(message, message_type, encoding, field_names(wanted))
    return timed(columns_of_points(packed, wanted), read_header(message, encoding).stamp_ns)


def read_coordinates(message: bytes, message_type: str, encoding: Encoding = "cdr") -> NDArray[np.float64]:
    """The points as `read_points` gives them, before they are rounded to float32."""
    return decode_coordinates(_packed(message, message_type, encoding), CloudLimits())


def _packed(message: bytes, message_type: str, encoding: Encoding, names: tuple[str, ...] = COORDINATES) -> PackedCloud:
    """A cloud with the fields of such `names`, by default its coordinates: faults of other fields cost no scan."""
    fields = _Fields(message, encoding)
    fields.header()
    return _livox(fields) if message_type in LIVOX_TYPES else _point_cloud_2(fields, names)


def _livox(fields: _Fields) -> PackedCloud:
    """The cloud of a CustomMsg of Livox's drivers.

    A point is a time since the first one (uint32, ns), x, y, z (float32, metres), reflectivity, tag and line (uint8
    each): 19 bytes, which CDR aligns to 20 but for the last.
    """
    fields.number("Q")
    fields.number("I")
    fields.numbers("B", 4)
    count = int(fields.number("I"))
    step = LIVOX_POINT_BYTES + fields.padding(LIVOX_POINT_BYTES, 4)
    size = max(count * step - (step - LIVOX_POINT_BYTES), 0)
    data = fields.take(size) + bytes(count * step - size)
    return PackedCloud(LIVOX_POINT, step, count, data, big_endian=fields.big_endian)


def _point_cloud_2(fields: _Fields, names: tuple[str, ...]) -> PackedCloud:
    height, width = (int(value) for value in fields.numbers("I", 2))
    count = int(fields.number("I"))
    if count > MAX_FIELDS:
        raise MalformedBody(f"a cloud with {count} fields")
    given = [_column(fields) for _ in range(count)]
    columns = tuple(column for column in given if column.name.lower() in names)
    if not columns and names[0] in COORDINATES:
        raise BadField(f"the cloud has no fields x, y and z, but {', '.join(column.name for column in given)}"[:200])
    big_endian = bool(fields.number("B"))
    point_step, row_step = (int(value) for value in fields.numbers("I", 2))
    data = _without_padding(fields.raw(), height, width * point_step, row_step)
    return PackedCloud(columns, point_step, width, data, height, big_endian)


def _without_padding(data: bytes, height: int, row_bytes: int, row_step: int) -> bytes:
    """The rows of a cloud side by side; `data` as it is where it has not the size of rows `row_step` apart.

    The stated size of a message is believed only if its bytes bear it out.
    """
    if row_step <= row_bytes or len(data) != height * row_step:
        return data
    return np.frombuffer(data, dtype=np.uint8).reshape(height, row_step)[:, :row_bytes].tobytes()


def read_pose(message: bytes, message_type: str, encoding: Encoding = "cdr") -> StampedTransform:
    """The pose in an Odometry, TransformStamped or PoseStamped; the latter names no child frame.

    Raises MalformedBody, BadTransform.
    """
    fields = _Fields(message, encoding)
    header = fields.header()
    child = fields.frame() if message_type in (ODOMETRY, TRACKED) else ""
    return StampedTransform(header.stamp_ns, header.frame, child, fields.quaternion_pose())


def read_fix(message: bytes, encoding: Encoding = "cdr") -> SatelliteFix:
    """The fix in a NavSatFix. Raises MalformedBody."""
    fields = _Fields(message, encoding)
    header, status = fields.header(), int(fields.number("b"))
    fields.number("H")  # which systems of satellites
    latitude, longitude, altitude = (float(value) for value in fields.numbers("d", 3))
    covariance = np.reshape(fields.numbers("d", 9), (3, 3)).astype(np.float64)
    known = int(fields.number("B")) > 0
    return SatelliteFix(
        header.stamp_ns, header.frame, status, (latitude, longitude, altitude), covariance if known else None
    )


def read_path(message: bytes, encoding: Encoding = "cdr") -> list[StampedTransform]:
    """The poses of a nav_msgs/Path; those that name no frame are in that of the path.

    Raises MalformedBody, BadTransform.
    """
    fields = _Fields(message, encoding)
    frame = fields.header().frame
    count = int(fields.number("I"))
    if count > MAX_PATH_POSES:
        raise MalformedBody(f"a path with {count} poses")
    return [_path_pose(fields, frame) for _ in range(count)]


def _path_pose(fields: _Fields, frame: str) -> StampedTransform:
    header = fields.header()
    return StampedTransform(header.stamp_ns, header.frame or frame, "", fields.quaternion_pose())


def read_transforms(message: bytes, encoding: Encoding = "cdr") -> list[StampedTransform]:
    """The transforms of a tf2_msgs/TFMessage. Raises MalformedBody, BadTransform."""
    fields = _Fields(message, encoding)
    count = int(fields.number("I"))
    if count > MAX_TRANSFORMS:
        raise MalformedBody(f"a message with {count} transforms")
    return [_transform(fields) for _ in range(count)]


def _transform(fields: _Fields) -> StampedTransform:
    header, child = fields.header(), fields.frame()
    return StampedTransform(header.stamp_ns, header.frame, child, fields.quaternion_pose())


def _column(fields: _Fields) -> PointField:
    """A field of a point; some drivers write a count of 0 where they mean 1."""
    name, offset = fields.text(), int(fields.number("I"))
    return PointField(name, offset, int(fields.number("B")), max(int(fields.number("I")), 1))
