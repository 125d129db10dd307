"""What the bridge reads of ROS messages: clouds, poses and times. Any object with the fields of the message will do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.geometry.deskew import SweepMotion, deskewed, knots
from revisit.core.scan import validate_intensity
from revisit.formats.cloud import CloudLimits
from revisit.formats.point_times import point_offsets
from revisit.formats.pointcloud2 import PackedCloud, PointField, decode_packed
from revisit.formats.satellite_fix import SatelliteFix

Points = NDArray[np.float32]


@dataclass(frozen=True)
class StampedPose:
    """Where the frame `child` was in the frame `parent`. T_parent_child (4, 4), nanoseconds."""

    stamp_ns: int
    parent: str
    child: str
    T_parent_child: se3.Matrix4


def stamp_ns(header: Any) -> int:
    """The time of a std_msgs/Header, nanoseconds."""
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def frame(name: str) -> str:
    """The name of a frame as TF 2 has it, without a slash in front."""
    return name.removeprefix("/")


def points_of(cloud: Any, motion: SweepMotion | None = None, *, intensity: bool = False) -> Points:
    """The finite points (n, 3) of a sensor_msgs/PointCloud2 that lie off the sensor's origin, metres.

    They are deskewed where the `motion` of the sensor is given. With `intensity` they are (n, 4), where the cloud has
    one that can be used. Raises core.errors.RevisitError for fields or sizes that cannot be.
    """
    packed = _packed(cloud)
    decoded = decode_packed(packed, CloudLimits())
    points = decoded.points
    kept = np.isfinite(points).all(axis=1) & (points != 0.0).any(axis=1)
    offsets = None if motion is None else point_offsets(packed, stamp_ns(cloud.header))
    moved = points[kept] if motion is None or offsets is None else deskewed(points[kept], offsets[kept], motion)
    told = _usable(decoded.intensity, points, kept) if intensity else None
    return np.asarray(moved if told is None else np.column_stack([moved, told]), dtype=np.float32)


def _usable(
    intensity: NDArray[np.floating] | None, points: NDArray[np.floating], kept: NDArray[np.bool_]
) -> NDArray[np.float32] | None:
    """The intensity of the points that are kept; None where there is none, or none that the service takes."""
    if intensity is None or not intensity.any():
        return None
    try:
        return validate_intensity(intensity[kept], points[kept])
    except BadField:
        return None


def knots_of(cloud: Any) -> NDArray[np.int64] | None:
    """The times since the stamp at which the pose of the sensor deskews a cloud; None where points have no times."""
    offsets = point_offsets(_packed(cloud), stamp_ns(cloud.header))
    return None if offsets is None else knots(offsets)


def _packed(cloud: Any) -> PackedCloud:
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
