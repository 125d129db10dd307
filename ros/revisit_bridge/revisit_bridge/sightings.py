"""Points that the world knows: fixes of satellites, and surveyed points that the robot sees, become anchors.

A sighting waits until scans before and after its time are of one session, and the pose at its time and the mounting of
its frame are known. Between two sessions the odometry may have begun anew: there it is left out.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from revisit.core.errors import RevisitError
from revisit.core.geometry import se3
from revisit.formats.satellite_fix import SatelliteFix
from revisit.sdk.anchors import FixSpacing, NewAnchor
from revisit_bridge.pairing import Mountings, PoseSource, Unknown

log = logging.getLogger("revisit_bridge")

MAX_WAITING = 1_000
"""Fixes of 50 s at 20 a second: scans come much sooner, or never."""

Place = tuple[float, float, float]


class Outcome(Enum):
    """What became of a sighting."""

    KEPT = "kept"
    WAITS = "waits"
    NEAR_THE_LAST = "near the last one"
    LEFT_OUT = "left out"


@dataclass(frozen=True)
class Sighting:
    """A point at `point_m` in the `frame` of the robot, "" for that of the sensor, at a time in nanoseconds.

    `anchor` makes the anchor of T_odom_sensor (4, 4) and of the point in the frame of the sensor, metres. Of those that
    are `spaced`, one a metre of the drive is taken.
    """

    stamp_ns: int
    frame: str
    anchor: Callable[[se3.Matrix4, Place], NewAnchor]
    point_m: Place = (0.0, 0.0, 0.0)
    spaced: bool = False

    @classmethod
    def of_fix(cls, fix: SatelliteFix) -> Sighting:
        """A fix: the point is the antenna, the origin of its frame."""
        return cls(fix.stamp_ns, fix.frame, lambda T, offset_m: NewAnchor.of_fix(fix, T, offset_m), spaced=True)


@dataclass(frozen=True)
class _Waiting:
    since_s: float
    sighting: Sighting


@dataclass(frozen=True)
class _Stretch:
    """The drive of the session so far, by the times of its scans, and the frame of its sensor."""

    first_ns: int
    last_ns: int
    sensor_frame: str


@dataclass
class Sightings:
    """Takes sightings, and hands anchors of the session that is driven to `keep`, which may raise RevisitError.

    A sighting waits for `wait_s` of the monotonic clock `now_s` at most. `left_out` counts those of which no anchor was
    made, `problem` says why the last one was; `no_place` counts fixes of a receiver that told no place.
    """

    poses: PoseSource
    transforms: Mountings
    keep: Callable[[NewAnchor], None]
    wait_s: float
    now_s: Callable[[], float]
    left_out: int = 0
    no_place: int = 0
    problem: str = ""
    _waiting: deque[_Waiting] = field(default_factory=deque)
    _drive: _Stretch | None = None
    _spacing: FixSpacing = field(default_factory=FixSpacing)

    def take_fix(self, fix: SatelliteFix) -> None:
        """The next fix of the receiver."""
        if fix.is_place:
            self.take(Sighting.of_fix(fix))
        else:
            self.no_place += 1

    def take(self, sighting: Sighting) -> Outcome:
        """The next sighting, which may be late."""
        waiting = _Waiting(self.now_s(), sighting)
        outcome = self._settled(waiting)
        if outcome is Outcome.WAITS:
            self._waiting.append(waiting)
            if len(self._waiting) > MAX_WAITING:
                self._leave_out("more of them wait than there is room for", self._waiting.popleft().sighting)
        return outcome

    def begin(self, sensor_frame: str, stamp_ns: int) -> None:
        """A session begins with a scan: those that wait are of the time before it."""
        self.end()
        self._drive = _Stretch(stamp_ns, stamp_ns, sensor_frame)

    def go_on(self, sensor_frame: str, since_ns: int, stamp_ns: int) -> None:
        """The next scan of the session; the one before was at `since_ns`."""
        first_ns = self._drive.first_ns if self._drive is not None else since_ns
        self._drive = _Stretch(first_ns, stamp_ns, sensor_frame)
        self.settle()

    def end(self) -> None:
        """The session has ended."""
        for waiting in self._waiting:
            self._leave_out("its session ended before a later scan came", waiting.sighting)
        self._waiting.clear()
        self._drive, self._spacing = None, FixSpacing()

    def settle(self) -> None:
        """Look again at those that wait."""
        self._waiting = deque(one for one in self._waiting if self._settled(one) is Outcome.WAITS)

    def _settled(self, waiting: _Waiting) -> Outcome:
        sighting, drive = waiting.sighting, self._drive
        if drive is None or sighting.stamp_ns > drive.last_ns:
            return self._waits(waiting, *self._later(sighting))
        if sighting.stamp_ns < drive.first_ns:
            before_s = (drive.first_ns - sighting.stamp_ns) / 1e9
            return self._leave_out("its time is before the session", sighting, f", by {before_s:.1f} s")
        T_odom_sensor = self.poses.sensor_pose(drive.sensor_frame, sighting.stamp_ns)
        if T_odom_sensor is Unknown.NOT_YET:
            return self._waits(waiting, "the pose at its time is not known")
        offset_m = self._offset(sighting, drive)
        if isinstance(offset_m, Unknown) and offset_m is Unknown.NOT_YET:
            return self._waits(waiting, self._untold(sighting, drive))
        if isinstance(T_odom_sensor, Unknown) or isinstance(offset_m, Unknown):
            return self._leave_out("the odometry does not reach back to its time", sighting)
        return self._anchored(sighting, T_odom_sensor, offset_m)

    def _anchored(self, sighting: Sighting, T_odom_sensor: se3.Matrix4, offset_m: Place) -> Outcome:
        if sighting.spaced and not self._spacing.takes(T_odom_sensor):
            self.problem = ""
            return Outcome.NEAR_THE_LAST
        try:
            self.keep(sighting.anchor(T_odom_sensor, offset_m))
        except RevisitError as error:
            return self._leave_out(error.message, sighting)
        self.problem = ""
        return Outcome.KEPT

    def _offset(self, sighting: Sighting, drive: _Stretch) -> Place | Unknown:
        """The point in the frame of the sensor, metres."""
        sensor = self.poses.posed_frame(drive.sensor_frame)
        if sighting.frame in ("", sensor):
            return sighting.point_m
        T_sensor_frame = self.transforms(sensor, sighting.frame, sighting.stamp_ns)
        if isinstance(T_sensor_frame, Unknown):
            return T_sensor_frame
        x, y, z = se3.apply(T_sensor_frame, np.array([sighting.point_m]))[0].tolist()
        return x, y, z

    def _waits(self, waiting: _Waiting, why: str, detail: str = "") -> Outcome:
        if self.now_s() - waiting.since_s < self.wait_s:
            return Outcome.WAITS
        return self._leave_out(why, waiting.sighting, detail)

    def _leave_out(self, why: str, sighting: Sighting, detail: str = "") -> Outcome:
        """Count it; say why, and to the log once for a reason."""
        told = f"{'a fix' if sighting.spaced else 'a point'} was left out: {why}"
        if not self.problem.startswith(told):
            log.warning("%s%s", told, detail)
        self.left_out, self.problem = self.left_out + 1, told + detail
        return Outcome.LEFT_OUT

    def _later(self, sighting: Sighting) -> tuple[str, str]:
        """Why a sighting that is later than all scans has waited in vain, and by how much it is later."""
        if self._drive is None:
            return "there was no scan", ""
        later_s = (sighting.stamp_ns - self._drive.last_ns) / 1e9
        return "its time is after the last scan", f", by {later_s:.1f} s: is the clock that of the LiDAR?"

    def _untold(self, sighting: Sighting, drive: _Stretch) -> str:
        sensor = self.poses.posed_frame(drive.sensor_frame) or "the sensor"
        return f"TF does not tell where {sighting.frame} is on the robot, from {sensor}: publish its mounting"
