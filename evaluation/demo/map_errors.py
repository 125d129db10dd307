"""How far the robots' submaps are from the truth: as their odometry has them, and in the map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.evaluation.demo.truth import TrueSubmap
from revisit.evaluation.trajectory_error import rigid_fit, trajectory_error

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RobotTrack:
    """The submaps of a robot in their order: where they truly are, and where odometry and the map have them.

    All three are (n, 3), metres in the true world. Odometry starts at the true pose of the robot's first submap; the
    map as a whole, with all robots, is laid on the truth by the best rigid fit. T_map_odom (4, 4) is the robot's
    correction.
    """

    robot: str
    truth: Floats
    odometry: Floats
    in_map: Floats
    T_map_odom: se3.Matrix4

    @cached_property
    def way_m(self) -> Floats:
        """Metres driven up to each submap (n,)."""
        steps = np.linalg.norm(np.diff(self.truth, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @cached_property
    def odometry_off_m(self) -> Floats:
        """How far odometry is from the truth at each submap (n,)."""
        return np.asarray(np.linalg.norm(self.odometry - self.truth, axis=1))

    @cached_property
    def map_off_m(self) -> Floats:
        """How far the map is from the truth at each submap (n,)."""
        return np.asarray(np.linalg.norm(self.in_map - self.truth, axis=1))

    @property
    def odometry_ate_m(self) -> float:
        """Absolute trajectory error of the odometry, metres."""
        return trajectory_error(self.odometry, self.truth)

    @property
    def map_ate_m(self) -> float:
        """Absolute trajectory error of this robot in the map, metres."""
        return trajectory_error(self.in_map, self.truth)


@dataclass(frozen=True)
class MapReport:
    """Errors of the demo's map: each robot's track, and the loop closures of the map."""

    tracks: tuple[RobotTrack, ...]
    loops_in_map: int
    loops_set_aside: int

    @property
    def ate_m(self) -> float:
        """Absolute trajectory error of all robots in one map, with one fit for all of them."""
        in_map, truth = (np.concatenate([getattr(one, name) for one in self.tracks]) for name in ("in_map", "truth"))
        return trajectory_error(in_map, truth)

    @property
    def better(self) -> bool:
        """Whether all robots in one map are nearer to the truth than the worst of them by its odometry alone."""
        return self.ate_m < max(track.odometry_ate_m for track in self.tracks)


def judge_map(
    submaps: Mapping[str, TrueSubmap],
    T_odom_submap: Mapping[str, se3.Matrix4],
    T_map_submap: Mapping[str, se3.Matrix4],
    T_map_odom: Mapping[str, se3.Matrix4],
    loops: tuple[int, int],
) -> MapReport:
    """Compare odometry and map with the truth.

    Poses are given by submap, corrections by robot; `loops` counts those in the map and those set aside. All submaps
    lie in one frame of the map. Raises KeyError for a submap without a pose.
    """
    ordered = sorted(submaps.values(), key=lambda submap: submap.order)
    truth = np.stack([submap.T_world_submap[:3, 3] for submap in ordered])
    in_map = np.stack([T_map_submap[submap.name][:3, 3] for submap in ordered])
    fitted = se3.apply(rigid_fit(in_map, truth), in_map)
    tracks = []
    for robot in dict.fromkeys(submap.robot for submap in ordered):
        rows = [row for row, submap in enumerate(ordered) if submap.robot == robot]
        odometry = np.stack([T_odom_submap[ordered[row].name] for row in rows])
        T_world_odom = ordered[rows[0]].T_world_submap @ se3.inverse(odometry[0])
        believed = (T_world_odom @ odometry)[:, :3, 3]
        tracks.append(RobotTrack(robot, truth[rows], believed, fitted[rows], T_map_odom[robot]))
    return MapReport(tuple(tracks), *loops)
