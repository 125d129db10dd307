"""Rotating LiDARs: where their beams point and how well they see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.evaluation.simulator.blocks import Floats, Material

# Share of the light that comes back from a surface hit head-on; grazing hits return less (Lambert).
REFLECTIVITY = {
    Material.GROUND: 0.25, Material.GRASS: 0.4, Material.WALL: 0.6, Material.GLASS: 0.25, Material.ROOF: 0.35,
    Material.LEAF: 0.55, Material.METAL: 0.5, Material.CLOTH: 0.5, Material.WINDSCREEN: 0.05,
}  # fmt: skip


@dataclass(frozen=True)
class LidarModel:
    """A rotating LiDAR. elevations_deg (b,) of its beams; `columns` shots a turn; lengths in metres.

    `reach_m`: a head-on surface that returns half of the light is seen with probability 1/2 at this distance.
    """

    name: str
    elevations_deg: tuple[float, ...]
    columns: int
    min_range_m: float
    max_range_m: float
    range_noise_m: float
    reach_m: float
    dropout: float

    @property
    def beams(self) -> int:
        """How many beams the sensor has."""
        return len(self.elevations_deg)

    def directions(self) -> NDArray[np.float32]:
        """Unit vectors (beams * columns, 3) in the sensor frame (x ahead, y left, z up), beam by beam."""
        elevation = np.radians(np.asarray(self.elevations_deg))[:, None]
        azimuth = -2 * np.pi * np.arange(self.columns)[None] / self.columns
        x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
        z = np.broadcast_to(np.sin(elevation), x.shape)
        return np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)

    def detection_probability(self, range_m: Floats, cosine: Floats, material: NDArray[np.uint8]) -> Floats:
        """Probability (n,) that a hit at `range_m` under an angle of incidence of `cosine` is reported."""
        table = np.array([REFLECTIVITY[kind] for kind in sorted(REFLECTIVITY)])
        signal = table[material] * (0.05 + 0.95 * cosine) * (self.reach_m / np.maximum(range_m, 1.0)) ** 2
        return np.asarray((1.0 - self.dropout) * signal**2 / (signal**2 + 0.25))


def _hdl64() -> tuple[float, ...]:
    upper = np.linspace(2.0, -8.33, 32)
    lower = np.linspace(-8.83, -24.33, 32)
    return tuple(float(angle) for angle in np.concatenate([upper, lower]))


HDL64 = LidarModel("hdl64", _hdl64(), 2000, 1.5, 80.0, 0.02, 95.0, 0.02)
HDL32 = LidarModel("hdl32", tuple(np.linspace(10.67, -30.67, 32).tolist()), 1800, 1.0, 70.0, 0.02, 75.0, 0.03)
VLP16 = LidarModel("vlp16", tuple(np.linspace(15.0, -15.0, 16).tolist()), 1800, 0.8, 80.0, 0.02, 80.0, 0.03)
OS1_64 = LidarModel("os1-64", tuple(np.linspace(16.6, -16.6, 64).tolist()), 1024, 0.8, 90.0, 0.03, 70.0, 0.04)
SENSORS = {sensor.name: sensor for sensor in (HDL64, HDL32, VLP16, OS1_64)}
