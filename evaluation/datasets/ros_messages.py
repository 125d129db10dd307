"""ROS 2 messages as they lie in bags (CDR): PointCloud2, and poses out of Odometry or PoseStamped."""

from __future__ import annotations

import struct

import numpy as np

from revisit.core.errors import MalformedBody
from revisit.core.geometry import se3
from revisit.core.scan import Points
from revisit.formats.cloud import CloudLimits
from revisit.formats.pointcloud2 import PackedCloud, PointField, decode_packed

CLOUD_TYPES = ("sensor_msgs/msg/PointCloud2",)
POSE_TYPES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")
MAX_FIELDS = 64


class _Cdr:
    """Reads values in turn, each aligned to its own size, from behind the encapsulation header."""

    def __init__(self, message: bytes) -> None:
        if len(message) < 4 or message[0] != 0 or message[1] not in (0, 1):
            raise MalformedBody("the message is no CDR")
        self._data = memoryview(message)[4:]
        self._order = "<" if message[1] == 1 else ">"
        self._at = 0

    def number(self, code: str) -> float | int:
        """One value of a struct code."""
        return self.numbers(code, 1)[0]

    def numbers(self, code: str, count: int) -> tuple[float | int, ...]:
        """`count` values of a struct code."""
        size = struct.calcsize(f"={code}")
        self._at += -self._at % size
        try:
            values = struct.unpack_from(f"{self._order}{count}{code}", self._data, self._at)
        except struct.error as error:
            raise MalformedBody("the message ends too early") from error
        self._at += size * count
        return values

    def raw(self) -> bytes:
        """A sequence of bytes, or a string with its final zero."""
        length = int(self.number("I"))
        if self._at + length > len(self._data):
            raise MalformedBody("the message ends too early")
        value = bytes(self._data[self._at : self._at + length])
        self._at += length
        return value

    def text(self) -> str:
        """A string."""
        return self.raw().rstrip(b"\0").decode("utf-8", errors="replace")


def read_stamp(message: bytes) -> int:
    """The time in the header of a message, nanoseconds. Raises MalformedBody."""
    return _header(_Cdr(message))


def read_points(message: bytes) -> Points:
    """The points (n, 3) of a sensor_msgs/PointCloud2. Raises MalformedBody, BadField, TooLarge."""
    cdr = _Cdr(message)
    _header(cdr)
    height, width = (int(value) for value in cdr.numbers("I", 2))
    count = int(cdr.number("I"))
    if count > MAX_FIELDS:
        raise MalformedBody(f"a cloud with {count} fields")
    fields = tuple(_field(cdr) for _ in range(count))
    big_endian = bool(cdr.number("B"))
    point_step, row_step = (int(value) for value in cdr.numbers("I", 2))
    data = cdr.raw()
    if height > 1 and row_step != width * point_step:
        data = b"".join(data[row * row_step : row * row_step + width * point_step] for row in range(height))
    packed = PackedCloud(fields, point_step, width, data, height, big_endian)
    return decode_packed(packed, CloudLimits()).points


def read_pose(message: bytes, message_type: str) -> se3.Matrix4:
    """The pose in an Odometry or PoseStamped. Raises MalformedBody, BadTransform."""
    cdr = _Cdr(message)
    _header(cdr)
    if message_type == "nav_msgs/msg/Odometry":
        cdr.text()
    values = np.array(cdr.numbers("d", 7), dtype=np.float64)
    return se3.from_quaternion(values[3:], values[:3])


def _header(cdr: _Cdr) -> int:
    """Reads a std_msgs/Header: its time in nanoseconds."""
    seconds, nanoseconds = int(cdr.number("i")), int(cdr.number("I"))
    cdr.text()
    return seconds * 10**9 + nanoseconds


def _field(cdr: _Cdr) -> PointField:
    name, offset = cdr.text(), int(cdr.number("I"))
    return PointField(name, offset, int(cdr.number("B")), int(cdr.number("I")))
