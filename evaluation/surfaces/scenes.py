"""Submaps with a truth of their own: walls in closed form, a simulated town, real drives with scans held out."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from revisit.core.config import SubmapConfig
from revisit.core.errors import EmptyCloud
from revisit.core.geometry import se3
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.evaluation.cutting import cut
from revisit.evaluation.datasets import KittiRecording
from revisit.evaluation.perturbations import Perturbation
from revisit.evaluation.scene import estimate_scene_scale
from revisit.evaluation.simulator import HDL64, LidarModel, StreetGrid, build_city, drive, grid_drive, simulate
from revisit.evaluation.simulator.traffic import ParkedCars
from revisit.evaluation.surfaces.metrics import HeldOutReturns, TrueTriangles, Truth

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


def simulated_town(count: int, sensor: LidarModel = HDL64) -> Iterator[Scene]:
    """Up to `count` submaps of 10 m spread along a drive through a town, 7 scans each; truth is the town itself.

    What should be held: what the same sensor without noise sees from between the scans. What moves is left out of it.
    """
    grid = StreetGrid.random(3, 3, TOWN_SEED)
    world = build_city(grid.streets(), TOWN_SEED)
    path = grid_drive(grid, [(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1)])
    trajectory = drive(path, world.ground, lane_m=1.8, spacing_m=0.8)
    starts = np.linspace(5, len(trajectory) - 20, count).astype(int)
    exact = dataclasses.replace(sensor, range_noise_m=0.0)
    for start in starts:
        part = dataclasses.replace(
            trajectory, T_world_sensor=trajectory.T_world_sensor[start : start + 13],
            stamps_ns=trajectory.stamps_ns[start : start + 13],
        )  # fmt: skip
        noisy = list(simulate(world, part, sensor, TOWN_SEED))[::2]
        seen = list(simulate(world, part, exact, TOWN_SEED))[1::2]
        scans = [Scan.validated(s.points, s.T_world_sensor, s.stamp_ns) for s in noisy]
        submap = Submap.from_scans(scans, SubmapConfig()).levelled()
        inverse = se3.inverse(submap.T_odom_submap)
        cars = ParkedCars(world.parking).around(part.T_world_sensor[6, :2, 3])
        corners = np.concatenate([world.triangles, *(car.triangles() for car in cars)])
        middle = part.T_world_sensor[6, :3, 3]
        corners = corners[np.abs(corners - middle).max(axis=2).min(axis=1) < 100.0]
        triangles = se3.apply(inverse, corners.reshape(-1, 3)).reshape(-1, 3, 3)
        samples = [se3.apply(inverse @ s.T_world_sensor, s.points[~s.moving]) for s in seen]
        yield Scene(submap, TrueTriangles(triangles.astype(np.float32), np.concatenate(samples).astype(np.float32)))


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
            submap = Submap.from_scans(scans, config)
        except EmptyCloud:
            continue
        level, frame = submap.in_level_frame(unit_m)
        inverse = se3.inverse(submap.T_odom_submap)
        truth = Submap.from_scans([recording.scan(index) for index in unseen], config)
        samples = se3.apply(inverse @ truth.T_odom_submap, truth.points)
        yield Scene(level, HeldOutReturns(frame.points_to_level(samples).astype(np.float32)), unit_m)
