"""A view: the last scans of a robot that moves, joined by its odometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import SubmapConfig
from revisit.core.errors import EmptyCloud
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.scan import MIN_POINTS, Points
from revisit.core.scan_marks import ScanMarks, Way
from revisit.core.submap import Submap

_LEAST_SPACING_M = 0.05


@dataclass(frozen=True)
class ViewCloud:
    """Scans in the sensor frame of the newest one.

    points (n, 3) float32 metres; ends: behind the last point of each scan; origins (s, 3) float32, the sensor of each;
    T_odom_view (4, 4) is the pose of the newest scan.
    """

    points: Points
    ends: tuple[int, ...]
    origins: Points
    T_odom_view: Matrix4

    @property
    def submap(self) -> Submap:
        """The view as a submap that can be described. Raises EmptyCloud, BadField where the parts do not fit."""
        if len(self.points) < MIN_POINTS:
            raise EmptyCloud(f"only {len(self.points)} points lie within the sensor's range", field="points")
        counts = np.diff([0, *self.ends])
        return Submap(
            points=self.points,
            scan_index=np.repeat(np.arange(len(counts), dtype=np.int32), counts),
            origins=self.origins,
            stamps_ns=np.zeros(len(counts), dtype=np.int64),
            T_odom_submap=self.T_odom_view,
            position=self.T_odom_view[:3, 3].copy(),
        )


@dataclass(frozen=True)
class _Kept:
    """A scan of the window: its returns within range (n, 3), its pose, and the way up to it, metres."""

    points: Points
    T_odom_sensor: Matrix4
    travelled_m: float


class ViewWindow:
    """The scans of the last tau metres of travel: one at each of `scans_per_tau` marks, and the newest.

    Holds at most twice `enough_returns` points, however fast scans come.
    """

    def __init__(self, config: SubmapConfig) -> None:
        self._config = config
        self._kept: list[_Kept] = []
        self._way: Way | None = None

    @property
    def travelled_m(self) -> float:
        """The way since the first scan."""
        return 0.0 if self._way is None else self._way.travelled_m

    def add(self, points: NDArray[np.floating], T_odom_sensor: Matrix4) -> ViewCloud:
        """The view with one more scan (n, 3), metres in its sensor frame. Raises EmptyCloud."""
        near = _within_range(points, self._config)
        if len(near) < MIN_POINTS:
            raise EmptyCloud(
                f"only {len(near)} of {len(points)} points lie within the sensor's range: are they in metres?",
                field="points",
            )
        self._way = ScanMarks.of(self._config).way_to(T_odom_sensor, self._way)
        self._settle()
        self._kept.append(_Kept(_thinned(near, self._config.enough_returns), T_odom_sensor, self.travelled_m))
        while self._kept[0].travelled_m < self.travelled_m - self._config.tau:
            del self._kept[0]
        return self._joined()

    def _settle(self) -> None:
        """Keep the newest scan for good where it is a mark, and thinned; drop it where it is none."""
        spacing_m = max(self._config.tau / self._config.scans_per_tau, _LEAST_SPACING_M)
        if len(self._kept) > 1 and self._kept[-1].travelled_m - self._kept[-2].travelled_m < spacing_m:
            del self._kept[-1]
        elif self._kept:
            newest = self._kept[-1]
            few = self._config.enough_returns // self._config.scans_per_tau
            self._kept[-1] = _Kept(_thinned(newest.points, few), newest.T_odom_sensor, newest.travelled_m)

    def _joined(self) -> ViewCloud:
        T_odom_view = self._kept[-1].T_odom_sensor
        T_view_scans = [se3.inverse(T_odom_view) @ one.T_odom_sensor for one in self._kept]
        points = [
            se3.apply(T_view_scan, one.points).astype(np.float32)
            for T_view_scan, one in zip(T_view_scans, self._kept, strict=True)
        ]
        ends = tuple(np.cumsum([len(one) for one in points]).tolist())
        origins = np.array([T_view_scan[:3, 3] for T_view_scan in T_view_scans], dtype=np.float32)
        return ViewCloud(np.concatenate(points), ends, origins, T_odom_view)


def _within_range(points: NDArray[np.floating], config: SubmapConfig) -> Points:
    """The finite returns (n, 3) that the sensor's range explains."""
    ranges = np.linalg.norm(points, axis=1)
    return np.ascontiguousarray(points[(ranges >= config.min_range) & (ranges <= config.max_range)], dtype=np.float32)


def _thinned(points: Points, most: int) -> Points:
    """At most so many of the points, evenly spread in their order."""
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).astype(np.int64)]
