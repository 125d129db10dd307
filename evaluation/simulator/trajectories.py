"""Where the sensor is and when: drives along paths over the simulated ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.evaluation.simulator.blocks import Floats
from revisit.evaluation.simulator.paths import Path, StreetGrid


class Terrain(Protocol):
    """Heights of the ground that is driven on."""

    def terrain(self, xy: Floats) -> Floats:
        """Height (n,) in metres at `xy` (n, 2)."""


@dataclass(frozen=True)
class Trajectory:
    """Poses of the sensor. T_world_sensor (n, 4, 4) float64; stamps_ns (n,) int64."""

    T_world_sensor: Floats
    stamps_ns: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.stamps_ns)


def drive(
    path: Path, ground: Terrain, *, lane_m: float = 0.0, spacing_m: float = 1.0, speed_mps: float = 8.0,
    sensor_height_m: float = 1.73, start_s: float = 0.0, sway_seed: int | None = 0,
) -> Trajectory:  # fmt: skip
    """Drive along `path`, `lane_m` metres to its right, one scan every `spacing_m` metres.

    The car tilts with the ground; with a `sway_seed` it also wanders up to about 0.2 m in its lane and rocks a little.
    """
    lane = Path.through(path.sampled(0.5).beside(path.sampled(0.5).arc, np.full(len(path.sampled(0.5).arc), -lane_m)))
    arc = np.arange(0.0, lane.length, spacing_m)
    sway = _sway(arc, sway_seed)
    xy, yaw = lane.beside(arc, sway[:, 0]), lane.heading(arc, span=3.0) + sway[:, 1]
    ahead = 1.3 * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    left = 0.8 * np.stack([-np.sin(yaw), np.cos(yaw)], axis=1)
    pitch = np.arctan2(ground.terrain(xy - ahead) - ground.terrain(xy + ahead), 2.6) + sway[:, 2]
    roll = np.arctan2(ground.terrain(xy + left) - ground.terrain(xy - left), 1.6) + sway[:, 3]
    height = ground.terrain(xy) + sensor_height_m
    poses = np.stack([_pose(*row) for row in np.column_stack([xy, height, yaw, pitch, roll])])
    stamps = np.round((start_s + arc / speed_mps) * 1e9).astype(np.int64)
    return Trajectory(poses, stamps)


def _sway(arc: Floats, seed: int | None) -> Floats:
    """Offsets (n, 4): lateral metres, yaw, pitch, roll radians; slow waves, zero without a seed."""
    if seed is None:
        return np.zeros((len(arc), 4))
    rng = np.random.default_rng([seed, 31])
    phase = rng.uniform(0, 2 * np.pi, (4, 3))
    waves = np.sin(arc[:, None, None] * 2 * np.pi / np.array([61.0, 37.0, 19.0]) + phase[None]).mean(axis=2)
    return np.asarray(waves * [0.25, 0.008, 0.008, 0.008])


def _pose(x: float, y: float, z: float, yaw: float, pitch: float, roll: float) -> se3.Matrix4:
    turn = se3.from_yaw(yaw, (x, y, z)) @ se3.exp((0, 0, 0, 0, pitch, 0)) @ se3.exp((0, 0, 0, roll, 0, 0))
    return np.asarray(turn)


def grid_drive_crossings() -> list[tuple[int, int]]:
    """Crossings of a drive on a 4 x 4 grid that meets itself in the same direction, in reverse and across."""
    return [
        (0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1), (0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (3, 2), (2, 2), (1, 2),
        (1, 1), (1, 0), (0, 0), (0, 1), (1, 1), (2, 1), (2, 2), (2, 3), (3, 3), (3, 2), (3, 1), (2, 1), (1, 1), (0, 1),
    ]  # fmt: skip


def grid_drive(grid: StreetGrid, crossings: list[tuple[int, int]] | None = None, corner_m: float = 6.0) -> Path:
    """The drive over `crossings` (by default `grid_drive_crossings`) with rounded corners."""
    return grid.route(crossings or grid_drive_crossings()).rounded(corner_m)
