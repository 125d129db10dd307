"""Days of a circuit of 318 m: parked cars and containers drawn anew each day, a wall that stands on some. Simulated."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lab.fleet.drives import drifting
from revisit.core.geometry import se3
from revisit.evaluation.simulator.blocks import Material, block
from revisit.evaluation.simulator.city import World, build_city
from revisit.evaluation.simulator.lidar import SimulatedScan, simulate
from revisit.evaluation.simulator.paths import Path, StreetGrid
from revisit.evaluation.simulator.sensors import HDL32, LidarModel
from revisit.evaluation.simulator.trajectories import Trajectory, drive
from tests.support.simulated_days import DAY_S, empty, parked_anew, with_wall

SEED = 11
BLOCK_M = (98.0, 66.0)
"""From street to street."""

LANE_M, STEP_M, DRIFT = 1.7, 1.5, 0.005
WALL, WALL_M = (45.0, -6.5), 14.0
CONTAINER_M = (5.0, 2.4, 2.6)
VERGE_M, SLOT_EACH_M = 7.8, 11.0
"""How far beside the street containers stand, and how far from each other along it."""

LEAST_VOXELS = 12
"""Of 0.4 m, in the box of a container, where one stands."""


@dataclass(frozen=True)
class Day:
    """A drive of a day: T_odom_sensor (n, 4, 4) begins anywhere and drifts."""

    number: int
    town: World
    trajectory: Trajectory
    T_odom_sensor: np.ndarray

    def scans(self, sensor: LidarModel = HDL32) -> Iterator[SimulatedScan]:
        return simulate(self.town, self.trajectory, sensor, self.number)


@dataclass(frozen=True)
class Circuit:
    """A town round one block, and what stands in it on which day."""

    walled: tuple[int, ...] = (4, 5, 6, 7, 8)

    @cached_property
    def way(self) -> Path:
        (x, y) = BLOCK_M
        corners = [(0.5 * x, 0.0), (x, 0.0), (x, y), (0.0, y), (0.0, 0.0), (0.5 * x, 0.0)]
        return Path.through([list(one) for one in corners]).rounded(6.0)

    @cached_property
    def town(self) -> World:
        grid = StreetGrid(np.array([0.0, BLOCK_M[0]]), np.array([0.0, BLOCK_M[1]]))
        return build_city(grid.streets(), SEED, drive=self.way)

    @cached_property
    def slots(self) -> list[tuple[np.ndarray, float]]:
        """Where containers may stand, and in which heading: places where nothing is, not even a crown over it."""
        arc = np.arange(6.0, self.way.length - 6.0, SLOT_EACH_M)
        heading = self.way.heading(arc, span=3.0)
        boxes = [
            (place, float(yaw))
            for side in (-VERGE_M, VERGE_M)
            for place, yaw in zip(self.way.beside(arc, np.full(len(arc), side)), heading, strict=True)
        ]
        scans = self.of_day(0, empty(self.town)).scans()
        seen = np.concatenate([se3.apply(one.T_world_sensor, one.points.astype(np.float64)) for one in scans])
        wall = [np.abs(place - WALL) > (WALL_M, 4.0) for place, _ in boxes]
        return [box for box, far in zip(boxes, wall, strict=True) if far.any() and not self.voxels(seen, *box)]

    def voxels(self, points: np.ndarray, place: np.ndarray, yaw: float) -> int:
        """How many voxels of the box of a container hold points (n, 3), half a metre above the ground and more."""
        local = (points[:, :2] - place) @ np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        high = points[:, 2] - self.town.ground.height(place[None])[0]
        inside = (np.abs(local) < 0.5 * np.array(CONTAINER_M[:2]) + 0.2).all(axis=1) & (high > 0.5) & (high < 3.0)
        return len(np.unique(np.floor(points[inside] / 0.4), axis=0))

    def taken(self, number: int) -> np.ndarray:
        """Which of the slots have a container on a day."""
        return np.random.default_rng([SEED, number]).random(len(self.slots)) < 0.5

    def of_day(self, number: int, town: World | None = None) -> Day:
        """The drive of a day, through the town as it is then."""
        town = self._on(number) if town is None else town
        trajectory = drive(
            self.way, town.ground, lane_m=LANE_M - 0.2 * (number % 3), spacing_m=STEP_M, start_s=number * DAY_S,
            sway_seed=number,
        )  # fmt: skip
        return Day(number, town, trajectory, drifting(trajectory.T_world_sensor, DRIFT, number))

    def _on(self, number: int) -> World:
        town = parked_anew(self.town, number)
        for (place, yaw), taken in zip(self.slots, self.taken(number), strict=True):
            town = self._with_container(town, place, yaw) if taken else town
        return with_wall(town, WALL, WALL_M) if number in self.walled else town

    def _with_container(self, town: World, place: np.ndarray, yaw: float) -> World:
        base = float(town.ground.height(place[None])[0])
        made = block((0, 0, 0), CONTAINER_M, Material.METAL).placed((*place, base), yaw)
        return dataclasses.replace(
            town,
            triangles=np.concatenate([town.triangles, made.triangles()]),
            materials=np.concatenate([town.materials, made.triangle_materials()]),
        )

    def with_containers(self, points: np.ndarray) -> np.ndarray:
        """Which of the slots have a container, by the points (n, 3) of a surface in the world."""
        return np.array([self.voxels(points, *box) >= LEAST_VOXELS for box in self.slots])

    def of_wall(self, points: np.ndarray) -> np.ndarray:
        """Which points (n, 3) are of the wall, its lowest 0.4 m left out: the ground is as near."""
        (x, y), half = WALL, 0.5 * WALL_M
        above = points[:, 2] - self.town.ground.height(np.array([WALL]))[0]
        beside = (np.abs(points[:, 0] - x) < half) & (np.abs(points[:, 1] - y) < 0.4)
        return np.asarray(beside & (above > 0.4) & (above < 2.2))
