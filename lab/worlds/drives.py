"""A world driven along legs, as a recording whose scans are cast when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lab.worlds.open_world import OpenWorld
from revisit.core.geometry import se3
from revisit.core.scan import Scan
from revisit.evaluation.simulator.lidar import Scene, measured
from revisit.evaluation.simulator.paths import Path
from revisit.evaluation.simulator.sensors import LidarModel
from revisit.evaluation.simulator.trajectories import Trajectory, drive

_KEPT_SCANS = 24
_BETWEEN_LEGS_S = 3_600.0


@dataclass(frozen=True)
class Leg:
    """One pass: along `path`, `lane_m` metres to its right. Other cars are parked on each leg."""

    path: Path
    lane_m: float = 0.0


@dataclass(frozen=True)
class Ride:
    """How legs are driven: scan spacing and height of the sensor in metres, and the seed of everything random.

    A recording's pose of a scan is off by `pose_noise_m` and `pose_noise_deg` (standard deviation, each axis).
    """

    sensor: LidarModel
    spacing_m: float = 1.5
    height_m: float = 1.8
    seed: int = 0
    pose_noise_m: float = 0.01
    pose_noise_deg: float = 0.05


@dataclass
class DrivenWorld:
    """A recording of a simulated sensor in a domain. The same world, legs and ride give the same scans."""

    name: str
    world: OpenWorld
    legs: Sequence[Leg]
    ride: Ride
    trajectory: Trajectory = field(init=False)
    _leg_of: NDArray[np.int64] = field(init=False)
    _scenes: dict[int, Scene] = field(init=False, default_factory=dict)
    _recent: dict[int, Scan] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        passes = [_pass(self.world, leg, self.ride, number) for number, leg in enumerate(self.legs)]
        self.trajectory = Trajectory(
            np.concatenate([one.T_world_sensor for one in passes]), np.concatenate([one.stamps_ns for one in passes])
        )
        self._leg_of = np.repeat(np.arange(len(passes)), [len(one) for one in passes])

    def __len__(self) -> int:
        return len(self.trajectory)

    def __iter__(self) -> Iterator[Scan]:
        return (self.scan(index) for index in range(len(self)))

    def __getstate__(self) -> dict[str, object]:
        """Without objects of this process: another one builds its own."""
        return {**vars(self), "_scenes": {}, "_recent": {}}

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """See Recording."""
        return self.trajectory.stamps_ns

    def pose(self, index: int) -> se3.Matrix4:
        """See Recording: the true pose of `trajectory`, as a good odometry would have it."""
        rng = np.random.default_rng([self.ride.seed, 43, index])
        shift, turn = rng.normal(0.0, self.ride.pose_noise_m, 3), rng.normal(0.0, self.ride.pose_noise_deg, 3)
        error = se3.exp(np.concatenate([shift, np.radians(turn)]))
        return np.asarray(self.trajectory.T_world_sensor[index] @ error)

    def scan(self, index: int) -> Scan:
        """See Recording. Raises EmptyCloud where the sensor sees next to nothing."""
        if index not in self._recent:
            self._recent[index] = self._cast(index)
            while len(self._recent) > _KEPT_SCANS:
                del self._recent[next(iter(self._recent))]
        return self._recent[index]

    def _cast(self, index: int) -> Scan:
        sensor, pose, stamp_ns = self.ride.sensor, self.trajectory.T_world_sensor[index], int(self.stamps_ns[index])
        directions = sensor.directions()
        rng = np.random.default_rng([self.ride.seed, 41, index])
        hits = self._scene(int(self._leg_of[index])).cast(
            pose[:3, 3], np.asarray(directions @ pose[:3, :3].T.astype(np.float32))
        )
        still = np.zeros(len(directions), dtype=bool)
        points = measured(hits, still, directions, sensor, rng, pose, stamp_ns).points
        return Scan.validated(points, self.pose(index), stamp_ns)

    def _scene(self, leg: int) -> Scene:
        """The world with the cars of a leg."""
        if leg not in self._scenes:
            cars = self.world.parked(1_000 * self.ride.seed + leg)
            triangles = np.concatenate([self.world.triangles, cars.triangles()])
            materials = np.concatenate([self.world.materials, cars.triangle_materials()])
            self._scenes = {leg: Scene(triangles, materials)}
        return self._scenes[leg]


def _pass(world: OpenWorld, leg: Leg, ride: Ride, number: int) -> Trajectory:
    return drive(
        leg.path, world.ground, lane_m=leg.lane_m, spacing_m=ride.spacing_m, sensor_height_m=ride.height_m,
        start_s=_BETWEEN_LEGS_S * number, sway_seed=100 * ride.seed + number,
    )  # fmt: skip


def winding_way(length_m: float, seed: int) -> Path:
    """A way that bends at random like a country road, with a turn of up to 90 degrees now and then."""
    rng = np.random.default_rng([seed, 23])
    count = int(length_m)
    turn = rng.normal(scale=0.03, size=count)
    for at in rng.choice(count, count // 120, replace=False):
        turn[at : at + 12] += rng.choice([-1.0, 1.0]) * rng.uniform(0.04, 0.12)
    heading = np.cumsum(turn)
    return Path.through(np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)).rounded(3.0)


def backwards(path: Path, start_m: float = 0.0, end_m: float | None = None) -> Path:
    """The part of `path` between two arc lengths, driven the other way."""
    arc = np.arange(start_m, path.length if end_m is None else end_m, 1.0)
    return Path.through(path.at(arc)[::-1])
