"""Vegetation that scatters as real crowns, hedges and bushes do: small leaves, densest near the rim.

Towns of `evaluation.simulator` have larger and fewer leaves; of their returns 9 % are scatter, of real ones 35 %
(`lab.realism`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.evaluation.simulator.blocks import Floats, Material, block, joined
from revisit.evaluation.simulator.vegetation import leaves

Triangles = NDArray[np.float32]

_LEAF_EDGE_M = (0.12, 0.35)
_BLADE_EDGE_M = (0.08, 0.25)
_LEAVES_PER_HEDGE_METRE = 160
_LEAVES_PER_CUBIC_METRE = 60.0  # of the box around a crown's half axes
_TRUNK_FROM_M = 2.5  # lower plants are bushes


def crown(centre: Floats, radii: Floats, rng: np.random.Generator) -> Triangles:
    """Leaves (n, 3, 3) in an ellipsoid around `centre` (3,) with `radii` (3,), metres."""
    count = 150 + int(4 * _LEAVES_PER_CUBIC_METRE * radii[0] * radii[1] * radii[2])
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    lobes = 0.8 + 0.3 * np.tanh(direction @ rng.normal(size=(3, 4))).max(axis=1, keepdims=True)
    shell = lobes * rng.uniform(0.3, 1.0, (count, 1)) ** 0.7
    return leaves(centre + direction * radii * shell, rng.uniform(*_LEAF_EDGE_M, count), rng)


def hedge(middle: Floats, yaw: float, length: float, rng: np.random.Generator) -> Triangles:
    """Leaves of a hedge of random height, 0.8 m thick, on the ground at `middle` (3,), along `yaw` radians."""
    count = int(length * _LEAVES_PER_HEDGE_METRE)
    along, across = rng.uniform(-length / 2, length / 2, count), rng.uniform(-0.4, 0.4, count)
    up = rng.uniform(0.0, rng.uniform(0.8, 2.2), count)
    c, s = np.cos(yaw), np.sin(yaw)
    centres = middle + np.stack([c * along - s * across, s * along + c * across, up], axis=1)
    return leaves(centres, rng.uniform(*_LEAF_EDGE_M, count), rng)


def herbs(feet: Floats, height: Floats, rng: np.random.Generator) -> Triangles:
    """Blades and small leaves over the ground points `feet` (n, 3), up to `height` (n,) above them."""
    tips = feet + np.column_stack([np.zeros((len(feet), 2)), rng.uniform(0.0, 1.0, len(feet)) * height])
    return leaves(tips, rng.uniform(*_BLADE_EDGE_M, len(feet)), rng)


def plant(foot: Floats, rng: np.random.Generator) -> tuple[Triangles, NDArray[np.uint8]]:
    """A tree, or now and then a bush, standing at `foot` (3,): triangles with their materials."""
    if rng.random() < 0.35:
        height, radius = rng.uniform(0.8, 2.0), rng.uniform(0.6, 1.5)
    else:
        height, radius = rng.uniform(3.0, 12.0), rng.uniform(0.9, 3.2)
    centre = foot + [0.0, 0.0, height * 0.62]
    green = crown(centre, np.array([radius, radius, height * 0.4]), rng)
    trunk = block((0, 0, -0.3), (0.3, 0.3, height * 0.5), Material.WALL, (0.6, 0.6)).placed(foot, rng.uniform(0, np.pi))
    wood = trunk if height > _TRUNK_FROM_M else joined([])
    materials = np.full(len(green), Material.LEAF, dtype=np.uint8)
    return np.concatenate([green, wood.triangles()]), np.concatenate([materials, wood.triangle_materials()])
