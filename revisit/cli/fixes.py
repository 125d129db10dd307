"""Fixes of satellites in a recording as anchors of its session."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.cli.output import refuse
from revisit.sdk.anchors import NewAnchor

if TYPE_CHECKING:
    from revisit.evaluation.datasets import Recording
    from revisit.evaluation.datasets.posed_clouds import StampedPoses
    from revisit.evaluation.datasets.ros_messages import SatelliteFix

ASSUMED_SIGMAS_M = {0: (3.0, 3.0, 6.0), 1: (1.5, 1.5, 3.0), 2: (0.5, 0.5, 1.0)}
"""East, north and up, by the status of a fix whose covariance nobody tells."""

LEAST_STEP_M = 1.0
"""Of the drive between two fixes: a robot that stands still learns nothing more of where it is."""

LEAST_VARIANCE_M2, MOST_VARIANCE_M2 = 1e-4, 1e6


def anchors_of(recording: Recording, topic: str | None, antenna_m: tuple[float, float, float]) -> list[NewAnchor]:
    """The fixes of a recording on its drive; those of `topic`, or of the one with most. Exits where there is no such
    topic. `antenna_m` is the antenna in the frame of the sensor.
    """
    from revisit.evaluation.datasets.posed_clouds import StampedPoses

    fixes: Mapping[str, Sequence[SatelliteFix]] = getattr(recording, "fixes", {})
    if topic is not None and topic not in fixes:
        raise refuse(f"{recording.name} has no fixes of satellites on {topic}: it has {', '.join(fixes) or 'none'}")
    chosen = topic or max(sorted(fixes), key=lambda name: len(fixes[name]), default=None)
    if chosen is None or not len(recording):
        return []
    poses = np.stack([recording.pose(index) for index in range(len(recording))])
    order = np.unique(recording.stamps_ns, return_index=True)[1]
    drive = StampedPoses(recording.stamps_ns[order], poses[order])
    return [_anchor(fix, T_odom_sensor, antenna_m) for fix, T_odom_sensor in _apart(_usable(fixes[chosen]), drive)]


def _usable(fixes: Sequence[SatelliteFix]) -> list[SatelliteFix]:
    """The fixes that tell a place, by rising time."""
    good = (one for one in fixes if one.status >= 0 and np.isfinite(one.position).all() and any(one.position[:2]))
    by_stamp = {one.stamp_ns: one for one in good}
    return [by_stamp[stamp] for stamp in sorted(by_stamp)]


def _apart(fixes: Sequence[SatelliteFix], drive: StampedPoses) -> Iterator[tuple[SatelliteFix, NDArray[np.float64]]]:
    """Fixes on the drive with the pose of the sensor, each some way behind the one before."""
    covered = drive.covered(np.array([one.stamp_ns for one in fixes], dtype=np.int64))
    last = None
    for fix, is_covered in zip(fixes, covered, strict=True):
        T_odom_sensor = drive.at(fix.stamp_ns) if is_covered else None
        if T_odom_sensor is None:
            continue
        if last is None or np.linalg.norm(T_odom_sensor[:3, 3] - last) >= LEAST_STEP_M:
            last = T_odom_sensor[:3, 3]
            yield fix, T_odom_sensor


def _anchor(fix: SatelliteFix, T_odom_sensor: NDArray[np.float64], antenna_m: tuple[float, float, float]) -> NewAnchor:
    return NewAnchor(
        f"gnss-{fix.stamp_ns}",
        "GNSS",
        fix.stamp_ns,
        _covariance(fix),
        geodetic=fix.position,
        offset_m=antenna_m,
        T_odom_sensor=T_odom_sensor,
    )


def _covariance(fix: SatelliteFix) -> NDArray[np.float64]:
    """The covariance (3, 3) told, within bounds; else an assumed one."""
    told = fix.covariance
    if told is None or not np.isfinite(told).all() or not (np.diag(told) > 0.0).all():
        return np.diag(np.square(ASSUMED_SIGMAS_M.get(fix.status, ASSUMED_SIGMAS_M[0])))
    variances, axes = np.linalg.eigh(0.5 * (told + told.T))
    return np.asarray((axes * np.clip(variances, LEAST_VARIANCE_M2, MOST_VARIANCE_M2)) @ axes.T)
