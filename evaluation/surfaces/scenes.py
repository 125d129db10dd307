"""Submaps with a truth of their own: walls in closed form, a simulated town, real drives with scans held out."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import SubmapConfig
from revisit.core.errors import EmptyCloud
from revisit.core.geometry import se3
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.evaluation.cutting import cut
from revisit.evaluation.datasets import KittiRecording
from revisit.evaluation.perturbations import Perturbation
from revisit.evaluation.real_data import has_real_data, real_recording
from revisit.evaluation.scene import estimate_scene_scale
from revisit.evaluation.simulator import (
    HDL64,
    LidarModel,
    StreetGrid,
    Trajectory,
    World,
    build_city,
    drive,
    grid_drive,
    simulate,
)  # fmt: skip
from revisit.evaluation.simulator.traffic import ParkedCars
from revisit.evaluation.surfaces.metrics import HeldOutReturns, TrueTriangles, Truth

Floats = NDArray[np.floating]

TOWN_SEED = 4_711
HOLD_OUT_EVERY = 3


@dataclass(frozen=True)
class Scene:
    """A submap in its level frame, lengths in units of `unit_m` metres, and the truth in the same frame."""

    submap: Submap
    truth: Truth
    unit_m: float = 1.0

    @property
    def raw_bytes(self) -> int:
        """The size of the submap's cloud as float32."""
        return 12 * len(self.submap.points)


def scene_groups(folder: Path, count: int = 2) -> dict[str, list[Scene]]:
    """All scenes by group, `count` of most; real ones only where REVISIT_DATA is set, unpacked into `folder`."""
    groups = {"walls with 2 cm noise (analytic)": [walls()], "town (simulated, HDL-64)": list(simulated_town(count))}
    if not has_real_data():
        return groups
    street, yard = real_recording("kitti00_head", folder), real_recording("hku1", folder)
    thin = Perturbation(keep_beams=16, keep_points=0.06)
    return groups | {
        "street (real, HDL-64)": list(held_out(street, 2 * count, Perturbation(), SubmapConfig())),
        "street (real, 16 beams)": list(held_out(street, count, Perturbation(keep_beams=16), SubmapConfig())),
        "street (real, 16 beams, 1,700 points a scan)": list(held_out(street, count, thin, SubmapConfig(tau=20.0))),
        "courtyard (real, Livox Avia)": list(held_out(yard, count, Perturbation(), SubmapConfig(tau=5.0, stride=2.0))),
    }


def walls(seed: int = 0) -> Scene:
    """A floor and four walls, 16 m apart, each with 2 cm of noise across it; truth in closed form."""
    rng = np.random.default_rng(seed)
    corners = np.array([[-8, -8], [8, -8], [8, 8], [-8, 8]], dtype=np.float64)
    quads = [np.column_stack([corners, np.full(4, -1.7)])]
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        quads.append(np.array([[*a, -1.7], [*b, -1.7], [*b, 3.0], [*a, 3.0]]))
    triangles = np.array([[q[i], q[j], q[k]] for q in quads for i, j, k in ((0, 1, 2), (0, 2, 3))], dtype=np.float32)
    on, normal = _spread_over(triangles, 120_000, rng)
    noisy = on + normal * rng.normal(0.0, 0.02, (len(on), 1))
    submap = Submap.from_cloud(Scan.validated(noisy.astype(np.float32), np.eye(4), 0))
    return Scene(submap, TrueTriangles(triangles, _spread_over(triangles, 60_000, rng)[0].astype(np.float32)))


def _spread_over(triangles: Floats, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Points (count, 3) spread evenly over `triangles` (t, 3, 3), and their unit normals (count, 3)."""
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    cross = np.cross(first, second)
    area = np.linalg.norm(cross, axis=1)
    rows = rng.choice(len(area), count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return triangles[rows, 0] + u * first[rows] + v * second[rows], cross[rows] / area[rows, None]


def simulated_town(count: int, sensor: LidarModel = HDL64) -> Iterator[Scene]:
    """`count` submaps of 10 m spread along a drive through a town, 7 scans each; truth is the town itself.

    What a map should hold is what the same sensor without noise sees from between the scans, but for what moves.
    """
    grid = StreetGrid.random(3, 3, TOWN_SEED)
    world = build_city(grid.streets(), TOWN_SEED)
    path = grid_drive(grid, [(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1)])
    trajectory = drive(path, world.ground, lane_m=1.8, spacing_m=0.8)
    for begin in np.linspace(5, len(trajectory) - 20, count).astype(int):
        part = Trajectory(trajectory.T_world_sensor[begin : begin + 13], trajectory.stamps_ns[begin : begin + 13])
        yield _town_scene(world, part, sensor)


def _town_scene(world: World, part: Trajectory, sensor: LidarModel) -> Scene:
    """Every second scan of `part` makes the map; the others without noise are its truth."""
    exact = dataclasses.replace(sensor, range_noise_m=0.0)
    scans = [
        Scan.validated(s.points, s.T_world_sensor, s.stamp_ns)
        for s in list(simulate(world, part, sensor, TOWN_SEED))[::2]
    ]
    submap = Submap.from_window(scans, SubmapConfig()).levelled()
    T_submap_world = se3.inverse(submap.T_odom_submap)
    unseen = list(simulate(world, part, exact, TOWN_SEED))[1::2]
    samples = [se3.apply(T_submap_world @ s.T_world_sensor, s.points[~s.moving]) for s in unseen]
    triangles = se3.apply(T_submap_world, _triangles_around(world, part).reshape(-1, 3)).reshape(-1, 3, 3)
    return Scene(submap, TrueTriangles(triangles.astype(np.float32), np.concatenate(samples).astype(np.float32)))


def _triangles_around(world: World, part: Trajectory) -> NDArray[np.float32]:
    """The fixed triangles (t, 3, 3) and parked cars within 100 m of the middle of a drive."""
    middle = part.T_world_sensor[len(part) // 2, :3, 3]
    cars = ParkedCars(world.parking).around(middle[:2])
    triangles = np.concatenate([world.triangles, *(car.triangles() for car in cars)])
    return np.asarray(triangles[np.abs(triangles - middle).max(axis=2).min(axis=1) < 100.0], dtype=np.float32)


def held_out(
    recording: KittiRecording, count: int, perturbation: Perturbation, config: SubmapConfig
) -> Iterator[Scene]:
    """Up to `count` submaps spread along a recording; every third scan is kept from the map and is its truth."""
    unit_m = estimate_scene_scale(recording)
    windows = [window for window in cut(recording, config) if len(window) >= HOLD_OUT_EVERY]
    for place in np.linspace(0, len(windows) - 1, count):
        window = windows[round(place)]
        unseen = window[1::HOLD_OUT_EVERY]
        scans = [recording.scan(index) for index in window if index not in unseen]
        scans = [dataclasses.replace(s, points=perturbation.thin(s.points, s.stamp_ns)) for s in scans]
        try:
            submap = Submap.from_window(scans, config)
        except EmptyCloud:
            continue
        level, frame = submap.in_level_frame(unit_m)
        inverse = se3.inverse(submap.T_odom_submap)
        truth = Submap.from_window([recording.scan(index) for index in unseen], config)
        samples = se3.apply(inverse @ truth.T_odom_submap, truth.points)
        yield Scene(level, HeldOutReturns(frame.points_to_level(samples).astype(np.float32)), unit_m)
