"""Ray casting: the returns of a LiDAR on a trajectory through a town."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.scan import Points
from revisit.evaluation.simulator.blocks import Blocks, Floats, joined
from revisit.evaluation.simulator.city import World
from revisit.evaluation.simulator.sensors import LidarModel
from revisit.evaluation.simulator.traffic import PERSON, VEHICLES, VISIBLE_M, ParkedCars
from revisit.evaluation.simulator.trajectories import Trajectory

NOSE_TO_TAIL_M = 4.5


@dataclass(frozen=True)
class SimulatedScan:
    """One sweep, taken in an instant (as if already deskewed).

    points (n, 3) float32 sensor frame, beam by beam; T_world_sensor its true pose; moving (n,) bool, whether a point
    lies on something that moves; beam (n,) uint8 index into the sensor's elevation table.
    """

    points: Points
    T_world_sensor: se3.Matrix4
    stamp_ns: int
    moving: NDArray[np.bool_]
    beam: NDArray[np.uint8]


@dataclass(frozen=True)
class Hits:
    """First hits of rays: range (n,) metres, inf for none; cosine (n,) of the incidence; material (n,)."""

    range_m: Floats
    cosine: Floats
    material: NDArray[np.uint8]


class Scene:
    """Triangles that rays can be cast at, on one thread."""

    def __init__(self, triangles: NDArray[np.float32], materials: NDArray[np.uint8]) -> None:
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._materials = np.append(materials, np.uint8(0))
        self._empty = len(triangles) == 0
        if not self._empty:
            corners = o3d.core.Tensor.from_numpy(np.ascontiguousarray(triangles.reshape(-1, 3)))
            index = np.arange(3 * len(triangles), dtype=np.uint32).reshape(-1, 3)
            self._scene.add_triangles(corners, o3d.core.Tensor.from_numpy(index))

    def cast(self, origin: Floats, directions: NDArray[np.float32]) -> Hits:
        """First hits of unit rays (n, 3) from `origin` (3,)."""
        if self._empty:
            count = len(directions)
            return Hits(np.full(count, np.inf), np.zeros(count), np.zeros(count, np.uint8))
        rays = np.empty((len(directions), 6), dtype=np.float32)
        rays[:, :3], rays[:, 3:] = origin, directions
        answer = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays), nthreads=1)
        distance = answer["t_hit"].numpy().astype(np.float64)
        # The id of a missed ray is the largest uint32: it is sent to the extra last material.
        primitive = np.minimum(answer["primitive_ids"].numpy(), len(self._materials) - 1)
        cosine = np.abs(np.einsum("ij,ij->i", answer["primitive_normals"].numpy(), directions)).astype(np.float64)
        return Hits(distance, cosine, self._materials[primitive])


def simulate(world: World, trajectory: Trajectory, sensor: LidarModel, seed: int) -> Iterator[SimulatedScan]:
    """The scans of `sensor` along `trajectory`, one by one. The same arguments give the same scans."""
    town = Scene(world.triangles, world.materials)
    parked = ParkedCars(world.parking)
    directions = sensor.directions()
    for index in range(len(trajectory)):
        rng = np.random.default_rng([seed, 41, index])
        T_world_sensor, stamp_ns = trajectory.T_world_sensor[index], int(trajectory.stamps_ns[index])
        rays = np.asarray(directions @ T_world_sensor[:3, :3].T.astype(np.float32))
        origin = T_world_sensor[:3, 3]
        moving_from, passing = _passing(world, parked, origin, stamp_ns)
        fixed = town.cast(origin, rays)
        hits, moving = _nearest(fixed, *_passing_hits(passing, moving_from, origin, rays))
        yield measured(hits, moving, directions, sensor, rng, T_world_sensor, stamp_ns)


def _passing(world: World, parked: ParkedCars, origin: Floats, stamp_ns: int) -> tuple[int, Blocks]:
    """Blocks near the sensor that are not there for good: parked ones first; from which index on they move."""
    standing = parked.around(origin[:2])
    traffic = world.traffic
    position, heading = traffic.poses(stamp_ns / 1e9)
    distance = np.linalg.norm(position - origin[:2], axis=1)
    near = np.flatnonzero((distance < VISIBLE_M) & (distance > np.where(traffic.kind >= 0, NOSE_TO_TAIL_M, 1.2)))
    level = world.ground.height(position[near])
    movers = [
        (VEHICLES[traffic.kind[i]] if traffic.kind[i] >= 0 else PERSON).placed([*position[i], z], float(heading[i]))
        for i, z in zip(near, level, strict=True)
    ]
    return sum(len(car) for car in standing), joined([*standing, *movers])


def _passing_hits(passing: Blocks, moving_from: int, origin: Floats, rays: NDArray[np.float32]) -> tuple[Hits, Hits]:
    """Hits of the rays on the standing and on the moving part of `passing`."""
    triangles, materials = passing.triangles(), passing.triangle_materials()
    split = 12 * moving_from
    standing = Scene(triangles[:split], materials[:split]).cast(origin, rays)
    return standing, Scene(triangles[split:], materials[split:]).cast(origin, rays)


def _nearest(fixed: Hits, standing: Hits, moving: Hits) -> tuple[Hits, NDArray[np.bool_]]:
    """The nearest of three hits of every ray, and whether it is the moving one."""
    ranges = np.stack([fixed.range_m, standing.range_m, moving.range_m])
    first = ranges.argmin(axis=0)
    pick = np.arange(ranges.shape[1])
    cosine = np.stack([fixed.cosine, standing.cosine, moving.cosine])[first, pick]
    material = np.stack([fixed.material, standing.material, moving.material])[first, pick]
    return Hits(ranges[first, pick], cosine, material), first == 2


def measured(
    hits: Hits, moving: NDArray[np.bool_], directions: NDArray[np.float32], sensor: LidarModel,
    rng: np.random.Generator, T_world_sensor: se3.Matrix4, stamp_ns: int,
) -> SimulatedScan:  # fmt: skip
    """The sensor's report of the hits: lost returns, range noise, its own limits."""
    within = (hits.range_m >= sensor.min_range_m) & (hits.range_m <= sensor.max_range_m)
    chance = sensor.detection_probability(np.where(within, hits.range_m, 1.0), hits.cosine, hits.material)
    seen = np.flatnonzero(within & (rng.random(len(chance)) < chance))
    noisy = hits.range_m[seen] + rng.normal(0.0, sensor.range_noise_m, len(seen))
    return SimulatedScan(
        points=np.asarray(directions[seen] * noisy[:, None], dtype=np.float32), T_world_sensor=T_world_sensor,
        stamp_ns=stamp_ns, moving=moving[seen], beam=(seen // sensor.columns).astype(np.uint8),
    )  # fmt: skip
