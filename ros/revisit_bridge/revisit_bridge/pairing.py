"""Each cloud with its pose: the odometry of a scan comes after the scan, so clouds wait for it."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.deskew import SweepMotion
from revisit_bridge.messages import StampedPose, frame, knots_of, stamp_ns

HISTORY_NS = 10 * 10**9


class Unknown(Enum):
    """Why there is no pose at a time: not yet, or never more."""

    NOT_YET = "not yet"
    NEVER = "never"


class PoseSource(Protocol):
    """Where a sensor was in the frame of the odometry."""

    def sensor_pose(self, sensor_frame: str, stamp: int) -> se3.Matrix4 | Unknown:
        """T_odom_sensor (4, 4) at a time in nanoseconds."""

    def posed_frame(self, sensor_frame: str) -> str:
        """The frame of the robot that `sensor_pose` places, "" where nobody names it."""


class Mountings(Protocol):
    """How frames of the robot lie in each other: TF."""

    def __call__(self, target: str, source: str, stamp: int) -> se3.Matrix4 | Unknown:
        """T_target_source at a time in nanoseconds."""


@dataclass(frozen=True)
class TransformPoses:
    """Poses from TF alone. `odom_frame` is the frame that moves smoothly."""

    odom_frame: str
    transforms: Mountings

    def sensor_pose(self, sensor_frame: str, stamp: int) -> se3.Matrix4 | Unknown:
        """See PoseSource."""
        return self.transforms(self.odom_frame, sensor_frame, stamp)

    def posed_frame(self, sensor_frame: str) -> str:
        """See PoseSource."""
        return sensor_frame


@dataclass
class OdometryPoses:
    """Poses from a topic of Odometry, interpolated between messages, with the mounting of the sensor from TF.

    Messages of the last 10 s are kept. A clock that goes back, or another frame, begins anew.
    """

    transforms: Mountings
    _poses: list[StampedPose] = field(default_factory=list)

    @property
    def odom_frame(self) -> str:
        """The frame that the messages name, "" before the first."""
        return self._poses[-1].parent if self._poses else ""

    def take(self, pose: StampedPose) -> None:
        """The next message."""
        if self._poses and (pose.stamp_ns <= self._poses[-1].stamp_ns or pose.parent != self._poses[-1].parent):
            if 0 <= self._poses[-1].stamp_ns - pose.stamp_ns < 10**9 and pose.parent == self._poses[-1].parent:
                return  # the same message again, or one that was late
            self._poses.clear()
        self._poses.append(pose)
        first = bisect_left([kept.stamp_ns for kept in self._poses], pose.stamp_ns - HISTORY_NS)
        del self._poses[:first]

    def sensor_pose(self, sensor_frame: str, stamp: int) -> se3.Matrix4 | Unknown:
        """See PoseSource."""
        T_odom_body = self._body_pose(stamp)
        if isinstance(T_odom_body, Unknown):
            return T_odom_body
        body = self._poses[-1].child
        if body == "" or self.posed_frame(sensor_frame) == body:
            return T_odom_body
        T_body_sensor = self.transforms(body, sensor_frame, stamp)
        return T_body_sensor if isinstance(T_body_sensor, Unknown) else T_odom_body @ T_body_sensor

    def posed_frame(self, sensor_frame: str) -> str:
        """See PoseSource. Clouds without a frame, and those that are registered, are taken to the body's."""
        body = self._poses[-1].child if self._poses else ""
        return body if sensor_frame in ("", self.odom_frame) else sensor_frame

    def _body_pose(self, stamp: int) -> se3.Matrix4 | Unknown:
        """T_odom_body on the screw motion between the two messages around a time."""
        if not self._poses or stamp > self._poses[-1].stamp_ns:
            return Unknown.NOT_YET
        after = bisect_left([pose.stamp_ns for pose in self._poses], stamp)
        later = self._poses[after]
        if later.stamp_ns == stamp:
            return later.T_parent_child
        if after == 0:
            return Unknown.NEVER
        earlier = self._poses[after - 1]
        share = (stamp - earlier.stamp_ns) / (later.stamp_ns - earlier.stamp_ns)
        step = se3.log(se3.inverse(earlier.T_parent_child) @ later.T_parent_child)
        return earlier.T_parent_child @ se3.exp(share * step)


@dataclass(frozen=True)
class PosedCloud:
    """A cloud message with the pose of its sensor, nanoseconds; `motion` of the sensor meanwhile, where it is known."""

    cloud: Any
    sensor_frame: str
    stamp_ns: int
    T_odom_sensor: se3.Matrix4
    motion: SweepMotion | None = None


@dataclass(frozen=True)
class _Waiting:
    """A cloud, since when it waits, and at which times since its stamp poses are needed to deskew it."""

    since_s: float
    cloud: Any
    knots_ns: NDArray[np.int64] | None


@dataclass
class WaitingClouds:
    """Clouds in the order they came, handed on with their poses.

    A cloud whose pose is not known after `wait_s` of the monotonic clock `now_s`, or for which there is no more room,
    is left out and counted in `left_out`. With `deskew`, a cloud whose points have times waits for the poses of all
    of them; without these it is handed on as it is.
    """

    poses: PoseSource
    wait_s: float
    max_waiting: int
    now_s: Callable[[], float]
    deskew: bool = False
    left_out: int = 0
    _waiting: deque[_Waiting] = field(default_factory=deque)

    def take(self, cloud: Any) -> None:
        """The next cloud."""
        self._waiting.append(_Waiting(self.now_s(), cloud, knots_of(cloud) if self.deskew else None))
        if len(self._waiting) > self.max_waiting:
            self._waiting.popleft()
            self.left_out += 1

    def ready(self) -> list[PosedCloud]:
        """The clouds in front whose poses are known; they wait no longer."""
        found = []
        while self._waiting:
            first = self._waiting[0]
            sensor_frame, stamp = frame(first.cloud.header.frame_id), stamp_ns(first.cloud.header)
            pose = self.poses.sensor_pose(sensor_frame, stamp)
            motion = None if isinstance(pose, Unknown) else self._motion(first, sensor_frame, stamp, pose)
            not_yet = pose is Unknown.NOT_YET or motion is Unknown.NOT_YET
            if not_yet and self.now_s() - first.since_s < self.wait_s:
                break
            self._waiting.popleft()
            if isinstance(pose, Unknown):
                self.left_out += 1
            else:
                known = motion if isinstance(motion, SweepMotion) else None
                found.append(PosedCloud(first.cloud, sensor_frame, stamp, pose, known))
        return found

    def _motion(
        self, waiting: _Waiting, sensor_frame: str, stamp: int, T_odom_sensor: se3.Matrix4
    ) -> SweepMotion | Unknown | None:
        """The motion of the sensor while the cloud was taken; None where points have no times."""
        if waiting.knots_ns is None:
            return None
        T_sensor_odom = se3.inverse(T_odom_sensor)
        poses = []
        for offset in waiting.knots_ns[::-1]:  # the last one is known last
            pose = self.poses.sensor_pose(sensor_frame, stamp + int(offset))
            if isinstance(pose, Unknown):
                return pose
            poses.append(T_sensor_odom @ pose)
        return SweepMotion(waiting.knots_ns, np.stack(poses[::-1]))
