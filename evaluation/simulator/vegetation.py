"""Trees and hedges as loose leaf triangles: light passes between them, as it does in real crowns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.evaluation.simulator.blocks import Blocks, Floats, Material, block, joined

Triangles = NDArray[np.float32]

LEAVES_PER_CROWN = 340
LEAVES_PER_HEDGE_METRE = 55


def leaves(centres: Floats, edge_m: Floats, rng: np.random.Generator) -> Triangles:
    """Randomly turned triangles (n, 3, 3) of about `edge_m` (n,) metres around `centres` (n, 3)."""
    corners = rng.normal(size=(len(centres), 3, 3))
    corners /= np.linalg.norm(corners, axis=2, keepdims=True)
    return np.asarray(centres[:, None] + corners * (edge_m * 0.58)[:, None, None], dtype=np.float32)


def crown(base: Floats, radius: float, height: float, rng: np.random.Generator) -> Triangles:
    """Leaves of an uneven ellipsoid of `radius` and `height` metres whose lowest point is `base` (3,)."""
    direction = rng.normal(size=(LEAVES_PER_CROWN, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    # Lobes: a crown is no perfect ellipsoid, and its outline tells one tree from another.
    lobes = rng.normal(size=(4, 3))
    outline = 0.8 + 0.25 * np.tanh(direction @ lobes.T).max(axis=1)
    shell = outline * rng.uniform(0.45, 1.0, LEAVES_PER_CROWN) ** 0.5
    centre = base + [0.0, 0.0, height / 2]
    size = rng.uniform(0.25, 0.55, LEAVES_PER_CROWN) * np.sqrt(radius / 2.0)
    return leaves(centre + direction * shell[:, None] * [radius, radius, height / 2], size, rng)


def tree(base: Floats, rng: np.random.Generator) -> tuple[Blocks, Triangles]:
    """A trunk and its crown standing at `base` (3,)."""
    radius, clear = rng.uniform(1.2, 3.2), rng.uniform(1.2, 2.8)
    height = radius * rng.uniform(1.4, 2.4)
    girth = rng.uniform(0.2, 0.5)
    trunk = block((0, 0, -0.5), (girth, girth, clear + height * 0.5), Material.WALL, (0.5, 0.5))
    return trunk.placed(base, rng.uniform(0, np.pi)), crown(base + [0, 0, clear], radius, height, rng)


def bush(base: Floats, rng: np.random.Generator) -> Triangles:
    """A shrub standing at `base` (3,)."""
    return crown(base - [0, 0, 0.2], rng.uniform(0.6, 1.3), rng.uniform(1.0, 2.4), rng)[:160]


def hedge(start: Floats, end: Floats, height: float, rng: np.random.Generator) -> Triangles:
    """Leaves of a hedge 0.7 m thick between two points (3,)."""
    length = float(np.linalg.norm(end - start))
    count = max(8, int(length * LEAVES_PER_HEDGE_METRE))
    along = (end - start) / max(length, 1e-6)
    across = np.array([-along[1], along[0], 0.0])
    centres = start + np.outer(rng.uniform(0, length, count), along) + np.outer(rng.uniform(-0.35, 0.35, count), across)
    centres[:, 2] += rng.uniform(0.0, height, count)
    return leaves(centres, rng.uniform(0.2, 0.4, count), rng)


def fence(start: Floats, end: Floats, height: float) -> Blocks:
    """Posts and rails between two points (3,)."""
    length = float(np.linalg.norm(end - start))
    yaw = float(np.arctan2(end[1] - start[1], end[0] - start[0]))
    posts = [block((x, 0, -0.3), (0.1, 0.1, height + 0.3), Material.WALL) for x in np.arange(0.0, length, 2.0)]
    slats = [block((length / 2, 0, z), (length, 0.05, 0.18), Material.WALL) for z in np.arange(0.15, height, 0.3)]
    return joined([*posts, *slats]).placed(start, yaw)
