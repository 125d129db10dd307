"""The ground that domains stand on: smooth heights, and the rough raster that a sensor sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.evaluation.simulator.blocks import Floats
from revisit.evaluation.simulator.trajectories import Terrain


@dataclass(frozen=True)
class Waves:
    """Gentle waves of many directions: amplitude (k,) metres, wave (k, 2) radians per metre, phase (k,) radians."""

    amplitude: Floats
    wave: Floats
    phase: Floats

    @classmethod
    def random(cls, rng: np.random.Generator) -> Waves:
        """Waves of 22 to 170 m, up to about 3 m high together."""
        length = np.array([140.0, 90.0, 60.0, 170.0, 35.0, 22.0])
        amplitude = np.array([1.2, 0.6, 0.3, 1.0, 0.06, 0.04]) * rng.uniform(0.3, 1.2, 6)
        return cls(amplitude, rng.normal(size=(6, 2)) * 2 * np.pi / length[:, None], rng.uniform(0, 2 * np.pi, 6))

    def terrain(self, xy: Floats) -> Floats:
        """See Terrain."""
        return np.asarray(np.sin(np.asarray(xy) @ self.wave.T + self.phase) @ self.amplitude)


@dataclass(frozen=True)
class NearestHeights:
    """Heights between known points of the ground, (n, 3), by the inverse of the distance to the nearest three."""

    known: Floats

    def terrain(self, xy: Floats) -> Floats:
        """See Terrain."""
        distance, nearest = cKDTree(self.known[:, :2]).query(np.atleast_2d(xy), k=3)
        weight = 1.0 / (distance + 0.5)
        heights = (self.known[nearest, 2] * weight).sum(axis=1) / weight.sum(axis=1)
        return np.asarray(heights if np.ndim(xy) > 1 else heights[0])


def ground_triangles(
    terrain: Terrain, way: Floats, rng: np.random.Generator, reach_m: float = 70.0, cell_m: float = 2.0
) -> NDArray[np.float32]:
    """A raster (n, 3, 3) of the ground up to `reach_m` beside the way (w, 2); rough where no wheel runs."""
    low, high = way.min(axis=0) - reach_m, way.max(axis=0) + reach_m
    xy = np.stack(np.meshgrid(*(np.arange(a, b, cell_m) for a, b in zip(low, high, strict=True)), indexing="ij"), -1)
    distance = cKDTree(way).query(xy.reshape(-1, 2))[0].reshape(xy.shape[:2])
    height = terrain.terrain(xy.reshape(-1, 2)).reshape(distance.shape)
    height += rng.normal(scale=0.04, size=height.shape) * (distance > 4.0)
    corner = np.concatenate([xy, height[..., None]], axis=-1)
    near = distance[:-1, :-1] < reach_m
    a, b, c, d = (part[near] for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.float32)
