"""Two simulated robots in one small town: a long drive that meets itself, and a short one against its direction."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from revisit.core.geometry import se3
from revisit.evaluation.simulator import (
    OS1_64,
    SimulatedScan,
    StreetGrid,
    Trajectory,
    World,
    build_city,
    drive,
    simulate,
)
from revisit.evaluation.simulator.blocks import Floats

# Crossings of the long drive: new streets, then two blocks again in the same direction, then five in reverse.
PATROL = [
    (0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (1, 1), (1, 0),
    (2, 0), (2, 1), (1, 1), (1, 2), (2, 2), (2, 1), (2, 0), (1, 0),
]  # fmt: skip
VISITOR = [(2, 2), (2, 1), (2, 0)]


@dataclass(frozen=True)
class DemoDrive:
    """One robot's drive. T_odom_sensor (n, 4, 4) is its odometry: it starts at the identity and drifts."""

    robot: str
    world: World
    trajectory: Trajectory
    T_odom_sensor: Floats
    seed: int

    def __len__(self) -> int:
        return len(self.trajectory)

    def scans(self, window: tuple[int, ...] | None = None) -> Iterator[SimulatedScan]:
        """The scans one by one, as they are taken; of a `window` alone with other noise than in the whole drive."""
        part = slice(None) if window is None else list(window)
        way = Trajectory(self.trajectory.T_world_sensor[part], self.trajectory.stamps_ns[part])
        return simulate(self.world, way, OS1_64, self.seed)

    @property
    def length_m(self) -> float:
        """Metres driven."""
        steps = np.diff(self.trajectory.T_world_sensor[:, :3, 3], axis=0)
        return float(np.linalg.norm(steps, axis=1).sum())

    @property
    def drift_m(self) -> float:
        """How far odometry is from the truth at the end, metres."""
        world = self.trajectory.T_world_sensor
        error = se3.inverse(se3.inverse(world[0]) @ world[-1]) @ self.T_odom_sensor[-1]
        return float(np.linalg.norm(error[:3, 3]))


def demo_drives(seed: int = 1, *, spacing_m: float = 2.0, block_m: float = 75.0) -> tuple[DemoDrive, DemoDrive]:
    """The patrol and, later the same day, the visitor on the opposite lane. The same seed gives the same drives."""
    grid = StreetGrid.random(3, 3, seed, block_m)
    routes = [grid.route(crossings).rounded(6.0) for crossings in (PATROL, VISITOR)]
    world = build_city(grid.streets(), seed)
    drives = []
    for index, (robot, route) in enumerate(zip(("patrol", "visitor"), routes, strict=True)):
        trajectory = drive(
            route, world.ground, lane_m=1.7, spacing_m=spacing_m, start_s=3600.0 * index, sway_seed=seed + index
        )
        odometry = drifting(trajectory.T_world_sensor, seed + index)
        drives.append(DemoDrive(robot, world, trajectory, odometry, seed + 100 * index))
    return drives[0], drives[1]


def drifting(T_world_sensor: Floats, seed: int) -> Floats:
    """Odometry (n, 4, 4) of a true trajectory: it starts at the identity and errs a little on every metre.

    Standard deviations per square root of a metre: 8 mm along each axis, 0.1 degrees of yaw, 0.005 of roll and pitch.
    """
    rng = np.random.default_rng([seed, 71])
    poses = [np.eye(4)]
    for before, after in itertools.pairwise(T_world_sensor):
        step = se3.inverse(before) @ after
        scale = np.sqrt(np.linalg.norm(step[:3, 3]))
        noise = rng.normal(size=6) * scale * np.array([0.008, 0.008, 0.004, *np.radians([0.005, 0.005, 0.1])])
        poses.append(poses[-1] @ step @ se3.exp(noise))
    return np.stack(poses)
