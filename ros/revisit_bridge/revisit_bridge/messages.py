"""What the bridge reads of ROS messages: clouds, poses and times. Any object with the fields of the message will do."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.deskew import SweepMotion, deskewed, knots
from revisit.core.point_columns import at_rows, usable
from revisit.formats.cloud import CloudLimits
from revisit.formats.point_times import point_offsets, timed
from revisit.formats.pointcloud2 import LIVOX_POINT, LIVOX_POINT_BYTES, PackedCloud, PointField, decode_packed
from revisit.formats.satellite_fix import SatelliteFix
from revisit.sdk.clouds import PointCloud

Points = NDArray[np.float32]


@dataclass(frozen=True)
class StampedPose:
    """Where the frame `child` was in the frame `parent`. T_parent_child (4, 4), nanoseconds."""

    stamp_ns: int
    parent: str
    child: str
    T_parent_child: se3.Matrix4


@dataclass(frozen=True)
class LivoxCloud:
    """A CustomMsg of Livox's drivers, its points side by side."""

    header: Any
    packed: PackedCloud


def received(message: Any) -> Any:
    """A sensor_msgs/PointCloud2 as it is; a CustomMsg as a LivoxCloud, made once, for each point is an object there."""
    return message if hasattr(message, "fields") else LivoxCloud(message.header, _packed_livox(message.points))


def _packed_livox(points: Collection[Any]) -> PackedCloud:
    kind = np.dtype({
        "names": [column.name for column in LIVOX_POINT], "formats": ["<u4", "<f4", "<f4", "<f4", "u1", "u1"],
        "offsets": [column.offset for column in LIVOX_POINT], "itemsize": LIVOX_POINT_BYTES,
    })  # fmt: skip
    rows = [(point.offset_time, point.x, point.y, point.z, point.reflectivity, point.line) for point in points]
    return PackedCloud(LIVOX_POINT, LIVOX_POINT_BYTES, len(rows), np.array(rows, dtype=kind).tobytes())


def stamp_ns(header: Any) -> int:
    """The time of a std_msgs/Header, nanoseconds."""
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def frame(name: str) -> str:
    """The name of a frame as TF 2 has it, without a slash in front."""
    return name.removeprefix("/")


def points_of(cloud: Any, motion: SweepMotion | None = None) -> Points:
    """The points of `cloud_of`, without columns."""
    return cloud_of(cloud, motion).points


def cloud_of(cloud: Any, motion: SweepMotion | None = None, columns: Collection[str] = ()) -> PointCloud:
    """The finite points (n, 3) of a sensor_msgs/PointCloud2 that lie off the sensor's origin, metres.

    They are deskewed where the `motion` of the sensor is given. They have those of the `columns` that the cloud has and
    that can be used. Raises core.errors.RevisitError for fields or sizes that cannot be.
    """
    packed, at_ns = _packed(cloud), stamp_ns(cloud.header)
    decoded = decode_packed(packed, CloudLimits(), wanted=columns)
    points = decoded.points
    kept = np.isfinite(points).all(axis=1) & (points != 0.0).any(axis=1)
    offsets = None if motion is None else point_offsets(packed, at_ns)
    moved = points[kept] if motion is None or offsets is None else deskewed(points[kept], offsets[kept], motion)
    told = usable(at_rows(timed(decoded.columns, at_ns), kept), points[kept])
    return PointCloud(np.asarray(moved, dtype=np.float32), told)


def knots_of(cloud: Any) -> NDArray[np.int64] | None:
    """The times since the stamp at which the pose of the sensor deskews a cloud; None where points have no times."""
    offsets = point_offsets(_packed(cloud), stamp_ns(cloud.header))
    return None if offsets is None else knots(offsets)


def _packed(cloud: Any) -> PackedCloud:
    if isinstance(cloud, LivoxCloud):
        return cloud.packed
    columns = tuple(PointField(item.name, item.offset, item.datatype, item.count) for item in cloud.fields)
    return PackedCloud(
        columns, cloud.point_step, cloud.width, _rows(cloud), height=cloud.height, big_endian=bool(cloud.is_bigendian)
    )


def _rows(cloud: Any) -> bytes:
    """The points' bytes without what some drivers put behind each row."""
    data, row_bytes = bytes(cloud.data), cloud.width * cloud.point_step
    if cloud.height <= 1 or cloud.row_step == row_bytes:
        return data
    starts = range(0, cloud.height * cloud.row_step, cloud.row_step) if cloud.row_step > 0 else ()
    return b"".join(data[start : start + row_bytes] for start in starts)


def pose_of(odometry: Any) -> StampedPose:
    """The pose of a nav_msgs/Odometry. Raises core.errors.BadTransform."""
    pose, header = odometry.pose.pose, odometry.header
    parent, child = frame(header.frame_id), frame(odometry.child_frame_id)
    return StampedPose(stamp_ns(header), parent, child, matrix(pose.position, pose.orientation))


def fix_of(message: Any) -> SatelliteFix:
    """The fix in a sensor_msgs/NavSatFix."""
    position = (float(message.latitude), float(message.longitude), float(message.altitude))
    told = np.reshape(np.asarray(message.position_covariance, dtype=np.float64), (3, 3))
    known, status = int(message.position_covariance_type) > 0, int(message.status.status)
    return SatelliteFix(
        stamp_ns(message.header), frame(message.header.frame_id), status, position, told if known else None
    )


def matrix(position: Any, orientation: Any) -> se3.Matrix4:
    """The transform (4, 4) of a position or translation and a quaternion. Raises core.errors.BadTransform."""
    quaternion = (orientation.x, orientation.y, orientation.z, orientation.w)
    return se3.from_quaternion(quaternion, (position.x, position.y, position.z))
