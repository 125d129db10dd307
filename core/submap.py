"""Submap: posed scans accumulated over the travelled distance tau_n (paper III-A)."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import SubmapConfig
from revisit.core.errors import BadField, EmptyCloud
from revisit.core.geometry import se3
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.geometry.upright import LEAST_LEAN_RAD
from revisit.core.point_columns import Columns, at_rows, joined
from revisit.core.sanity.ground import ground_lean
from revisit.core.scan import MIN_POINTS, Points, Scan
from revisit.core.scan_marks import ChosenScan, ScanMarks, Way, marked_rows


@dataclass(frozen=True)
class Submap:
    """Points of several scans in one frame: the sensor frame of the middle scan.

    points (n, 3) float32 metres; scan_index (n,) int32, the scan each point belongs to, ascending;
    origins (s, 3) float32, where each scan was taken from; stamps_ns (s,) int64;
    T_odom_submap the pose of the middle scan;
    position (3,) float64 the mean position of the scans in the odometry frame.
    Once `levelled`, points, origins and T_odom_submap are those of the level frame, and T_scan_submap (4, 4) leads from
    it back to that of the middle scan. `columns` of the points are those that all scans have; nothing rests on them.
    Raises BadField where the arrays do not fit together.
    """

    points: Points
    scan_index: NDArray[np.int32]
    origins: Points
    stamps_ns: NDArray[np.int64]
    T_odom_submap: se3.Matrix4
    position: NDArray[np.float64]
    T_scan_submap: se3.Matrix4 = field(default_factory=lambda: np.eye(4))
    columns: Columns = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, values in self.columns.items():
            if len(values) != len(self.points):
                raise BadField(f"a submap needs one {name} for each point, or none at all", field=name)
        if len(self.scan_index) != len(self.points) or len(self.stamps_ns) != len(self.origins):
            raise BadField(
                "a submap needs one scan index for each point and one time stamp for each origin", field="points"
            )
        if len(self.scan_index) and not 0 <= self.scan_index[0] <= self.scan_index[-1] < len(self.origins):
            raise BadField("a point of the submap belongs to no scan", field="points")
        if (self.scan_index[1:] < self.scan_index[:-1]).any():
            raise BadField("the points of a submap must be in the order of their scans", field="points")

    @property
    def scan_count(self) -> int:
        """How many scans the submap holds."""
        return len(self.origins)

    @property
    def leans(self) -> bool:
        """Whether its z axis, once it is in a level frame, is another one than that of the odometry frame."""
        return bool(self.T_odom_submap[2, 2] < np.cos(0.5 * LEAST_LEAN_RAD))

    def levelled(self, *, in_place: bool = False) -> Submap:
        """The same submap in a frame whose z axis is that of the odometry frame, turned as little as possible.

        Place recognition looks at places from above; a tilted sensor must not tilt them. `in_place` saves the room for
        the points: nobody may use the submap as it was any more.
        """
        up = self.T_odom_submap[2, :3]
        axis = np.cross(up, [0.0, 0.0, 1.0])
        sine, cosine = float(np.linalg.norm(axis)), float(up[2])
        if sine < 1e-6 and cosine > 0.0:
            return self
        # a sensor that hangs upside down may be turned about any horizontal axis
        direction = axis / sine if sine >= 1e-6 else np.array([1.0, 0.0, 0.0])
        T_upright_submap = se3.exp(np.concatenate([np.zeros(3), direction * np.arctan2(sine, cosine)]))
        return self._turned(T_upright_submap, in_place=in_place)

    def _turned(self, T_upright_submap: se3.Matrix4, *, in_place: bool = False) -> Submap:
        """The same submap in a frame that is turned, so that T_upright_submap (4, 4) leads there."""
        from revisit.core.kernels.rigid_motion import moved_points  # compiled: the gateway needs none of it

        T_odom_upright = self.T_odom_submap @ se3.inverse(T_upright_submap)
        return replace(
            self,
            points=moved_points(T_upright_submap, self.points, in_place=in_place),
            origins=se3.apply(T_upright_submap, self.origins).astype(np.float32),
            T_odom_submap=T_odom_upright,
            T_scan_submap=self.T_scan_submap @ (se3.inverse(self.T_odom_submap) @ T_odom_upright),
        )

    def in_level_frame(self, scene_scale: float) -> tuple[Submap, LevelFrame]:
        """The submap turned upright and with every length divided by `scene_scale`, and the frame it is in then, of
        that of the middle scan.

        Its z axis is that of the odometry frame, or the vertical of its own surfaces where these contradict that
        (decision 0360): `leans` tells.
        """
        from revisit.core.kernels.plane_votes import plane_scores  # compiled: the gateway needs none of it

        upright = self.levelled()
        up = ground_lean(upright.points, plane_scores)
        upright = upright if up is None else upright._turned(up.T_level_cloud())
        frame = LevelFrame.from_upright(upright.T_scan_submap, scene_scale)
        if scene_scale == 1.0:
            return upright, frame
        factor = np.float32(1.0 / scene_scale)
        return replace(upright, points=upright.points * factor, origins=upright.origins * factor), frame

    @classmethod
    def from_scans(cls, scans: list[Scan], config: SubmapConfig) -> Submap:
        """The submap of all these `scans` (in time order, at least one), in the frame of the middle one.

        Raises as `accumulated` does.
        """
        room = sum(len(scan.points) for scan in scans)
        return cls.accumulated(scans, scans[len(scans) // 2].T_odom_sensor, config, room)

    @classmethod
    def from_window(cls, scans: list[Scan], config: SubmapConfig) -> Submap:
        """The submap of those of a window's `scans` that are described (`described_scans`). Raises as `accumulated`."""
        return cls.from_scans(described_scans(scans, config), config)

    @classmethod
    def accumulated(cls, scans: Iterable[Scan], T_odom_submap: se3.Matrix4, config: SubmapConfig, room: int) -> Submap:
        """All of these `scans` (in time order, at least one) in the frame with this pose; they may come one by one.

        Returns out of the sensor's range are left out, and so are points beyond range and tau from the frame's
        origin: odometry that jumped. Raises EmptyCloud where fewer than 100 points remain, and BadField where the scans
        have more than `room` points together.
        """
        from revisit.core.kernels.rigid_motion import place_returns  # compiled: the gateway needs none of it

        T_submap_odom = se3.inverse(T_odom_submap)
        reach = config.min_range, config.max_range, config.max_range + config.tau
        points, ends, seen, given = np.empty((room, 3), dtype=np.float32), [0], [], 0
        carried = list[Columns]()
        for scan in scans:
            given += len(scan.points)
            if given > room:
                raise BadField(f"the scans of a submap have more than {room} points", field="points")
            T_submap_scan = T_submap_odom @ scan.T_odom_sensor
            rows = np.arange(len(scan.points) if scan.columns else 0, dtype=np.int32)
            kept = place_returns(T_submap_scan, scan.points, *reach, points[ends[-1] :], rows)
            carried.append(at_rows(scan.columns, rows[:kept]))
            ends.append(ends[-1] + kept)
            seen.append((T_submap_scan[:3, 3], scan.T_odom_sensor[:3, 3], scan.stamp_ns))
        origins, positions, stamps_ns = zip(*seen, strict=True)
        return cls(
            points=_enough(points[: ends[-1]], given),
            scan_index=np.repeat(np.arange(len(seen), dtype=np.int32), np.diff(ends)),
            origins=np.asarray(origins, dtype=np.float32),
            stamps_ns=np.array(stamps_ns, dtype=np.int64),
            T_odom_submap=T_odom_submap,
            position=np.mean(positions, axis=0),
            columns=joined(carried),
        )

    @classmethod
    def from_cloud(cls, scan: Scan, config: SubmapConfig = SubmapConfig()) -> Submap:
        """A submap that was accumulated elsewhere: one cloud, seen from its own origin.

        Points beyond range and tau are left out. Raises EmptyCloud where fewer than 100 points remain.
        """
        near = np.einsum("ij,ij->i", scan.points, scan.points) <= (config.max_range + config.tau) ** 2
        points = _enough(scan.points[near], len(scan.points))
        return cls(
            points=points,
            scan_index=np.zeros(len(points), dtype=np.int32),
            origins=np.zeros((1, 3), dtype=np.float32),
            stamps_ns=np.array([scan.stamp_ns], dtype=np.int64),
            T_odom_submap=scan.T_odom_sensor,
            position=scan.T_odom_sensor[:3, 3].copy(),
            columns=at_rows(scan.columns, near),
        )


def _enough(points: Points, given: int) -> Points:
    if len(points) < MIN_POINTS:
        raise EmptyCloud(
            f"only {len(points)} of {given} points lie within the sensor's range: are they in metres?", field="points"
        )
    return points


def described_scans(scans: list[Scan], config: SubmapConfig) -> list[Scan]:
    """Those of a window's `scans`, in time order, that are described (see `ScanMarks`); the first one is a mark."""
    rows = marked_rows(((scan.T_odom_sensor, len(scan.points)) for scan in scans), ScanMarks.of(config))
    return [scans[row] for row in rows]


def next_window_start(start_m: float, travelled_m: float, config: SubmapConfig) -> float:
    """Where the window after a finished one starts: whole strides on, so many that it is still open at `travelled_m`.

    Distances in metres travelled since the session began; no loop, because a pose may jump by any distance.
    """
    strides = math.floor((travelled_m - start_m - config.tau) / config.stride) + 1
    return start_m + config.stride * max(strides, 1)


class SubmapBuilder:
    """Cuts a stream of scans into submaps: windows of `tau` metres of travel, one starting every `stride` metres.

    Windows hold the scans that `ScanMarks` chooses, and begin and end with such.
    """

    def __init__(self, config: SubmapConfig) -> None:
        self._config = config
        self._marks = ScanMarks.of(config)
        self._chosen: ChosenScan | None = None
        self._window: deque[tuple[float, Scan]] = deque()
        self._way: Way | None = None
        self._window_start_m = 0.0
        self._emitted_to_m: float | None = None

    def add(self, scan: Scan) -> list[Scan] | None:
        """The scans of a finished submap, when `scan` completes its window, else None."""
        self._way = self._marks.way_to(scan.T_odom_sensor, self._way)
        travelled_m = self._way.travelled_m
        chosen = self._marks.choose(self._chosen, travelled_m, scan.T_odom_sensor, len(scan.points))
        if chosen is None:
            return None
        self._chosen = chosen
        self._window.append((travelled_m, scan))
        if travelled_m - self._window_start_m < self._config.tau:
            return None
        finished = [item for _, item in self._window]
        self._emitted_to_m = travelled_m
        self._window_start_m = next_window_start(self._window_start_m, travelled_m, self._config)
        while len(self._window) > 1 and self._window[0][0] < self._window_start_m:
            self._window.popleft()
        return finished

    def flush(self) -> list[Scan] | None:
        """The scans of a last, shorter submap at the end of a session, or None where nothing new was seen."""
        if not self._window or self._window[-1][0] == self._emitted_to_m:
            return None
        return [item for _, item in self._window]
