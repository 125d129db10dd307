"""Training samples along the rays and their labels (paper III-B 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import ImplicitMapConfig
from revisit.core.implicit_map.neural_points import NeuralPoints
from revisit.core.kernels.choose_returns import choose_returns
from revisit.core.kernels.voxel_table import VoxelTable

Array = NDArray[np.float32]

_MIN_COSINE = 0.2


@dataclass(frozen=True)
class Samples:
    """positions (n, 3) metres and their signed distance labels (n,) metres, positive in free space."""

    positions: Array
    labels: Array


def draw_samples(
    points: Array,
    origins: Array,
    neural: NeuralPoints,
    table: VoxelTable,
    config: ImplicitMapConfig,
    rng: np.random.Generator,
) -> Samples:
    """Samples on, before and behind returns (n, 3) seen from `origins` (n, 3), evenly over the neural points.

    A label is the distance along the ray times the cosine of incidence, cut at the truncation: the distance to the
    tangent plane instead of the (longer) distance along a grazing ray.
    """
    order = rng.permutation(len(points))
    chosen, owners = choose_returns(points, order, neural.positions, table, config.resolution, config.rays_per_point)
    hits = points[chosen]
    directions = origins[chosen] - hits
    directions /= np.linalg.norm(directions, axis=1, keepdims=True) + np.float32(1e-9)
    cosine = np.maximum(np.abs(np.sum(directions * neural.normals[owners], axis=1)), _MIN_COSINE)
    offsets = _ray_offsets(len(hits), config, rng)
    positions = hits[:, None] + offsets[:, :, None] * directions[:, None]
    labels = np.clip(offsets * cosine[:, None], -config.truncation, config.truncation)
    return Samples(positions.reshape(-1, 3).astype(np.float32), labels.reshape(-1).astype(np.float32))


def _ray_offsets(rays: int, config: ImplicitMapConfig, rng: np.random.Generator) -> Array:
    """Distances (rays, samples) from the return towards the sensor in metres: on, near, before and behind."""
    on = np.zeros((rays, 1))
    near = rng.normal(0.0, config.near_sigma, (rays, config.near_samples))
    front = rng.uniform(config.truncation / 2, config.front_reach, (rays, config.front_samples))
    behind = rng.uniform(-config.behind_reach, 0.0, (rays, config.behind_samples))
    return np.concatenate([on, near, front, behind], axis=1).astype(np.float32)
