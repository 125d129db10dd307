"""Three simulated robots on two days: one drives against the others, one has a scanner of 16 beams, all drift."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lab.worlds.changes import changed
from revisit.core.geometry import se3
from revisit.evaluation.simulator import (
    OS1_64,
    VLP16,
    LidarModel,
    SimulatedScan,
    StreetGrid,
    Trajectory,
    World,
    build_city,
    drive,
    simulate,
)
from revisit.evaluation.simulator.blocks import Floats

SEGMENT_M = 100.0
"""Drift is counted over ways of this length, as KITTI's odometry benchmark does it."""

DAY_S = 86_400.0


@dataclass(frozen=True)
class Robot:
    """A robot, its scanner, the share of the way by which its odometry drifts, and its crossings on each day."""

    name: str
    sensor: LidarModel
    drift: float
    routes: tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]]


ROBOTS = (
    Robot("amber", OS1_64, 0.010, (
        ((0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (1, 0), (2, 0)),
        ((1, 1), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1), (0, 0)),
    )),
    Robot("birch", OS1_64, 0.015, (  # against amber
        ((2, 0), (1, 0), (1, 1), (2, 1), (2, 0), (1, 0), (0, 0)),
        ((0, 1), (1, 1), (2, 1), (2, 0), (1, 0), (0, 0), (0, 1)),
    )),
    Robot("cedar", VLP16, 0.020, (
        ((0, 1), (0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1)),
        ((2, 1), (1, 1), (0, 1), (0, 0), (1, 0), (1, 1), (2, 1)),
    )),
)  # fmt: skip


@dataclass(frozen=True)
class FleetDrive:
    """One robot's drive on one day, 1 or 2.

    T_odom_sensor (n, 4, 4) is its odometry, from a start of its own.
    """

    robot: str
    day: int
    sensor: LidarModel
    world: World
    trajectory: Trajectory
    T_odom_sensor: Floats
    seed: int

    @property
    def name(self) -> str:
        """Of the session."""
        return f"{self.robot}-day{self.day}"

    def __len__(self) -> int:
        return len(self.trajectory)

    def scans(self) -> Iterator[SimulatedScan]:
        """The scans one by one, as they are taken."""
        return simulate(self.world, self.trajectory, self.sensor, self.seed)

    @property
    def length_m(self) -> float:
        """Metres driven."""
        return float(_way(self.trajectory.T_world_sensor)[-1])

    @property
    def drift(self) -> float:
        """The error of odometry after `SEGMENT_M` as a share of the way, on average."""
        return relative_drift(self.trajectory.T_world_sensor, self.T_odom_sensor)


def fleet_drives(seed: int = 1, *, spacing_m: float = 2.0, block_m: float = 75.0) -> tuple[FleetDrive, ...]:
    """Six drives, in the order in which they are driven. On the second day other cars are parked, trees are felled or
    bare, containers stand about. The same seed gives the same drives.
    """
    grid = StreetGrid.random(3, 2, seed, block_m)
    today = build_city(grid.streets(), seed)
    worlds = (today, changed(today, seed))
    drives = []
    for number, (day, robot) in enumerate(itertools.product((1, 2), ROBOTS)):
        route = grid.route(list(robot.routes[day - 1])).rounded(6.0)
        world, start_s = worlds[day - 1], day * DAY_S + 3600.0 * number
        trajectory = drive(
            route, world.ground, lane_m=1.7, spacing_m=spacing_m, start_s=start_s, sway_seed=10 * seed + number
        )
        odometry = drifting(trajectory.T_world_sensor, robot.drift, 10 * seed + number)
        drives.append(
            FleetDrive(robot.name, day, robot.sensor, world, trajectory, odometry, 100 * seed + number)
        )  # fmt: skip
    return tuple(drives)


def drifting(T_world_sensor: Floats, share: float, seed: int) -> Floats:
    """Odometry (n, 4, 4) of a true trajectory from a start of its own, anywhere within 200 m and in any heading.

    It drifts by `share` of the way: a wrong scale and a constant wrong turn, and noise that grows with the root of the
    way. Height, roll and pitch drift a fifth as fast.
    """
    rng = np.random.default_rng([seed, 72])
    constant, noise = rng.normal(size=6), rng.normal(size=(len(T_world_sensor) - 1, 6))
    start = se3.from_yaw(rng.uniform(-np.pi, np.pi), (*rng.uniform(-200.0, 200.0, 2), 0.0))
    strength = share
    for _ in range(6):  # the strength for that drift: it is nearly linear
        poses = _integrated(T_world_sensor, strength * constant, strength * noise)
        strength *= share / relative_drift(T_world_sensor, poses)
    return np.asarray(start @ _integrated(T_world_sensor, strength * constant, strength * noise))


def _integrated(T_world_sensor: Floats, constant: Floats, noise: Floats) -> Floats:
    """Steps with an error: `constant` (6,) a metre and `noise` (n - 1, 6) a root of a metre, in units of the drift."""
    units = np.array([1.0, 0.3, 0.2, 0.002, 0.002, 0.01])
    poses = [np.eye(4)]
    for (before, after), wrong in zip(itertools.pairwise(T_world_sensor), noise, strict=True):
        step = se3.inverse(before) @ after
        metres = float(np.linalg.norm(step[:3, 3]))
        poses.append(poses[-1] @ step @ se3.exp(units * (metres * constant + np.sqrt(metres) * wrong)))
    return np.stack(poses)


def relative_drift(T_world_sensor: Floats, T_odom_sensor: Floats) -> float:
    """How far odometry is off after `SEGMENT_M` as a share of that, averaged over all places to begin."""
    way = _way(T_world_sensor)
    ends = np.searchsorted(way, way + SEGMENT_M)
    starts = np.flatnonzero(ends < len(way))
    ends = ends[starts]
    true = np.linalg.inv(T_world_sensor[starts]) @ T_world_sensor[ends]
    measured = np.linalg.inv(T_odom_sensor[starts]) @ T_odom_sensor[ends]
    return float(np.linalg.norm((np.linalg.inv(true) @ measured)[:, :3, 3], axis=1).mean() / SEGMENT_M)


def _way(T_world_sensor: Floats) -> Floats:
    """Metres driven up to each pose (n,)."""
    steps = np.linalg.norm(np.diff(T_world_sensor[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])
