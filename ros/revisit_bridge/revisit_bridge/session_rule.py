"""When a scan goes on with the session of the last one, and when it begins a new one.

A session is one run of one odometry: its poses are in one frame that moves smoothly. After a reboot the odometry starts
at another origin, and nothing but a new session is right. Loops join the sessions again.
"""

from __future__ import annotations

import json
import os
import re
import time
from dataclasses import dataclass
from pathlib import Path

from revisit.core.errors import BadTransform
from revisit.core.geometry import se3

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
LATE_NS = 10**9


@dataclass(frozen=True)
class LastScan:
    """The last scan that was offered, sent or not. `boot` names the run of the machine, T_odom_sensor is (4, 4)."""

    session_id: str
    boot: str
    odom_frame: str
    sensor_frame: str
    stamp_ns: int
    T_odom_sensor: se3.Matrix4

    def save(self, file: Path) -> None:
        """Replace the file. Not synced: after a power cut the boot is another one anyhow."""
        told = {**vars(self), "T_odom_sensor": self.T_odom_sensor.tolist()}
        written = file.with_suffix(".new")
        written.write_text(json.dumps(told))
        written.replace(file)

    @classmethod
    def load(cls, file: Path) -> LastScan | None:
        """What `save` wrote; None where there is nothing of use."""
        try:
            told = json.loads(file.read_text())
            return cls(**{**told, "T_odom_sensor": se3.validated(told["T_odom_sensor"])})
        except (OSError, ValueError, TypeError, KeyError, BadTransform):
            return None


@dataclass(frozen=True)
class Motion:
    """What an odometry may do within a session: see the parameters of the same names."""

    max_jump_m: float
    max_speed_m_s: float
    max_gap_s: float


@dataclass(frozen=True)
class Continued:
    """The scan goes on with the session."""


@dataclass(frozen=True)
class Repeated:
    """The scan is no later than the last one, and not much earlier: it came twice, or too late."""


@dataclass(frozen=True)
class Begun:
    """The scan begins a new session, for a reason in words."""

    reason: str


def judge(last: LastScan | None, scan: LastScan, motion: Motion) -> Continued | Repeated | Begun:
    """Whether `scan` (whose session is not looked at) goes on with the session of `last`."""
    if last is None:
        return Begun("there was no scan before")
    if scan.boot != last.boot:
        return Begun("the machine was started anew")
    if scan.odom_frame != last.odom_frame or scan.sensor_frame != last.sensor_frame:
        return Begun(f"the frames are {scan.odom_frame} and {scan.sensor_frame}, "
                     f"they were {last.odom_frame} and {last.sensor_frame}")  # fmt: skip
    if last.stamp_ns - LATE_NS < scan.stamp_ns <= last.stamp_ns:
        return Repeated()
    seconds = (scan.stamp_ns - last.stamp_ns) / 1e9
    if seconds < 0.0:
        return Begun(f"the clock went back by {-seconds:.1f} s")
    if seconds > motion.max_gap_s:
        return Begun(f"there was no scan for {seconds:.1f} s: the odometry may have started anew")
    step_m = float(sum((scan.T_odom_sensor[:3, 3] - last.T_odom_sensor[:3, 3]) ** 2) ** 0.5)
    if step_m > motion.max_jump_m + motion.max_speed_m_s * seconds:
        return Begun(f"the odometry jumped by {step_m:.1f} m in {seconds:.2f} s")
    return Continued()


def boot_id() -> str:
    """What names this run of the machine; "" where the system does not tell."""
    return BOOT_ID.read_text().strip() if BOOT_ID.is_file() else ""


def new_session_id(robot_id: str, taken: set[str]) -> str:
    """An id that sorts by time and that no other run of the robot has, also where its clock was reset.

    `taken` holds ids of this robot that are known to be used.
    """
    prefix = re.sub(r"[^A-Za-z0-9._-]", "-", robot_id)[:30].lstrip("._-") or "robot"
    drawn = f"{prefix}-{time.strftime('%Y%m%d-%H%M%S', time.gmtime())}-{os.urandom(2).hex()}"
    return new_session_id(robot_id, taken) if drawn in taken else drawn
