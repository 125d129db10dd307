"""Training samples along the rays and their labels (paper III-B 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.config import ImplicitMapConfig
from revisit.core.implicit_map import voxel_hash
from revisit.core.implicit_map.neural_points import NeuralPoints

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
    slots: NDArray[np.int32],
    config: ImplicitMapConfig,
    rng: np.random.Generator,
) -> Samples:
    """Samples on, before and behind returns (n, 3) seen from `origins` (n, 3), evenly over the neural points.

    A label is the distance along the ray times the cosine of incidence, cut at the truncation: the distance to the
    tangent plane instead of the (longer) distance along a grazing ray.
    """
    order = rng.permutation(len(points))
    chosen, owners = _choose_returns(points, order, neural.positions, slots, config.resolution, config.rays_per_point)
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


@numba.njit(cache=True)
def _choose_returns(
    points: Array,
    order: NDArray[np.int64],
    positions: Array,
    slots: NDArray[np.int32],
    resolution: float,
    per_point: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Up to `per_point` returns for each neural point, in the given order: rows of `points` and their neural points."""
    taken = np.zeros(len(positions), dtype=np.int32)
    chosen = np.empty(len(positions) * per_point, dtype=np.int64)
    owners = np.empty(len(positions) * per_point, dtype=np.int64)
    size = 0
    for n in order:
        i = slots[
            voxel_hash.slot_of(
                int(np.floor(points[n, 0] / resolution)),
                int(np.floor(points[n, 1] / resolution)),
                int(np.floor(points[n, 2] / resolution)),
            )
        ]
        if i < 0 or taken[i] >= per_point:
            continue
        gap = 0.0
        for a in range(3):
            gap += (points[n, a] - positions[i, a]) ** 2
        if gap > 3.0 * resolution * resolution:
            continue
        taken[i] += 1
        chosen[size] = n
        owners[size] = i
        size += 1
        if size == len(chosen):
            break
    return chosen[:size], owners[:size]
