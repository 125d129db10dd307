"""The choice of the scans of a stream that are sent: by default those alone that descriptions are made of."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from revisit.core.geometry import se3
from revisit.core.scan_marks import ChosenScan, ScanMarks, Way
from revisit.sdk.clouds import PointsLike, count_returns
from revisit.sdk.reading import Json
from revisit.v1 import ingest_pb2

Send: TypeAlias = Literal["described", "all"]
"""The scans of a stream that are sent: those that descriptions are made of, or all."""

UNMET = ScanMarks(tau_m=3.0, least_per_tau=10, enough_returns=300_000, turn_rad=math.radians(10.0), least_step_m=0.02)
"""The marks of a spool before its service was met: nearer than those of any usual map, which are not known yet."""

LIFE_S = 5.0
"""After so long without a scan a stream sends its pose, as a sign of life."""


@dataclass(frozen=True)
class OfferedScan:
    """A scan with the way up to it; `chosen` where it is to be sent, else None."""

    way: Way
    chosen: ChosenScan | None


class ScanChoice:
    """Counts the way over all poses of a stream, and says which scans are sent."""

    def __init__(self, send: Send, way: Way | None, now_s: Callable[[], float] = time.monotonic) -> None:
        """Goes on from `way`, where an earlier stream has ended. Raises ValueError for another `send`."""
        if send not in ("described", "all"):
            raise ValueError(f"send must be 'described' or 'all', got {send!r}")
        self._everything = send == "all"
        self._way = way
        self._last = None if way is None else ChosenScan(way.travelled_m, (way.T_odom_sensor[:3, :3],))
        self._now_s = now_s
        self._alive_s = now_s()
        self.left_out = 0
        """Scans that were not sent, as no description would be made of them."""

    def look(self, pose: Json, points: PointsLike, marks: ScanMarks | None) -> OfferedScan:
        """The next scan of the robot. Where the `marks` of the service are not known, it is sent."""
        T_odom_sensor = pose_matrix(pose)
        self._way = (marks or UNMET).way_to(T_odom_sensor, self._way)
        if marks is None:
            return OfferedScan(self._way, ChosenScan(self._way.travelled_m, (T_odom_sensor[:3, :3],)))
        chosen = marks.choose(self._last, self._way.travelled_m, T_odom_sensor, count_returns(points))
        if chosen is None and self._everything:
            return OfferedScan(self._way, self._last)
        return OfferedScan(self._way, chosen)

    def sent(self, chosen: ChosenScan) -> None:
        """A chosen scan was taken; one that was not leaves its mark to the next."""
        self._last = chosen
        self._alive_s = self._now_s()

    def passed_over(self) -> bool:
        """A scan was left out; whether it is time for a sign of life."""
        self.left_out += 1
        due = self._now_s() - self._alive_s >= LIFE_S
        if due:
            self._alive_s = self._now_s()
        return due


def pose_matrix(pose: Json) -> se3.Matrix4:
    """The transform (4, 4) of the JSON of a pose, to the last bit as the service reads it."""
    rotation, translation = pose["rotation"], pose["translation"]
    return se3.from_quaternion([rotation[axis] for axis in "xyzw"], [translation[axis] for axis in "xyz"])


def way_of(opened: ingest_pb2.Opened) -> Way | None:
    """Where a session stands; None where it has no scan."""
    if not opened.HasField("t_odom_sensor"):
        return None
    translation, rotation = opened.t_odom_sensor.translation, opened.t_odom_sensor.rotation
    quaternion = (rotation.x, rotation.y, rotation.z, rotation.w)
    return Way(opened.travelled_m, se3.from_quaternion(quaternion, (translation.x, translation.y, translation.z)))


def marks_of(opened: ingest_pb2.Opened) -> ScanMarks | None:
    """The marks that a service announces; one of an earlier version announces none."""
    if not opened.HasField("marks"):
        return None
    told: Any = opened.marks
    return ScanMarks(told.tau_m, told.least_per_tau, told.enough_returns, told.turn_rad, told.least_step_m)
