"""Made-up worlds of blocks that look alike elsewhere: mirrored yards, two equal corridors; and drives through them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from revisit.core.geometry import se3
from revisit.evaluation.simulator.blocks import Blocks, Material, block, joined
from revisit.evaluation.simulator.lidar import Scene

HEIGHT_M = 1.5
STEP_M = 1.25
NOISE_M = 0.02

_ELEVATIONS = np.radians(np.linspace(-28.0, 20.0, 40))
_AZIMUTHS = np.linspace(-np.pi, np.pi, 540, endpoint=False)


def yard(seed: int, mirrored: bool) -> Blocks:
    """Houses and boxes of many sizes on both sides of a lane along x; `mirrored`, left and right are exchanged."""
    rng, side = np.random.default_rng(seed), -1.0 if mirrored else 1.0
    parts = [block((0, 0, -0.5), (160, 160, 0.5), Material.GROUND)]
    for _ in range(40):
        size = rng.uniform((1.5, 1.5, 1.5), (10, 8, 7))
        x, y = rng.uniform(-50, 50), rng.choice([-1, 1]) * rng.uniform(4.0 + size[1] / 2, 35.0)
        parts.append(block((x, side * y, 0), tuple(size), Material.WALL))
    return joined(parts)


def corridors(seed: int, spacing_m: float = 30.0, length_m: float = 36.0) -> Blocks:
    """Two equal corridors, parallel to x, `spacing_m` apart, open at their ends; posts along their walls."""
    parts = [block((20, spacing_m / 2, -0.5), (160, 160, 0.5), Material.GROUND)]
    rng = np.random.default_rng(seed)
    posts = [(x, rng.choice([-1, 1]), rng.uniform(0.4, 1.2)) for x in np.cumsum(rng.uniform(1.5, 5.0, 12))]
    for y in (0.0, spacing_m):
        for side in (-1, 1):
            parts.append(block((length_m / 2, y + 2.5 * side, 0), (length_m, 0.3, 3.0), Material.WALL))
        parts += [
            block((x, y + 2.2 * side, 0), (wide, 0.5, 2.6), Material.WALL) for x, side, wide in posts if x < length_m
        ]
    return joined(parts)


def twin_streets(seed: int, common_m: float, length_m: float = 170.0, apart_m: float = 400.0) -> Blocks:
    """Two streets along x, at y = 0 and y = `apart_m`: the same houses up to x = `common_m`, others behind."""
    parts = [block((length_m / 2, apart_m / 2, -0.5), (length_m + 200, apart_m + 200, 0.5), Material.GROUND)]
    for own, y in enumerate((0.0, apart_m)):
        parts += _houses(np.random.default_rng(seed), -60.0, common_m, y)
        parts += _houses(np.random.default_rng(seed + 1 + own), common_m, length_m + 60.0, y)
    return joined(parts)


def _houses(rng: np.random.Generator, first_m: float, last_m: float, y: float) -> Iterator[Blocks]:
    """Houses and boxes of many sizes on both sides of a street, from x = `first_m` to `last_m`."""
    for _ in range(round(0.5 * (last_m - first_m))):
        size = rng.uniform((1.5, 1.5, 1.5), (10, 8, 7))
        x = rng.uniform(first_m + size[0] / 2, last_m - size[0] / 2)
        side = rng.choice([-1, 1]) * rng.uniform(4.0 + size[1] / 2, 25.0)
        yield block((x, y + side, 0), tuple(size), Material.WALL)


def storey(period_m: float, bays: int = 6) -> Blocks:
    """A parking storey without cars: pillars in a square lattice under a roof, and parapets, 12 by 6 bays."""
    long, wide = bays * period_m, 3.0 * period_m
    parts = [block((0, 0, -0.5), (160, 160, 0.5), Material.GROUND)]
    parts.append(block((0, 0, 2.9), (2 * long, 2 * wide, 0.3), Material.WALL))
    for column in range(-bays, bays + 1):
        for row in range(-3, 4):
            parts.append(block((column * period_m, row * period_m, 0), (0.6, 0.6, 2.9), Material.WALL))
    for side in (-1, 1):
        parts.append(block((0, side * wide, 0), (2 * long, 0.3, 1.1), Material.WALL))
        parts.append(block((side * long, 0, 0), (0.3, 2 * wide, 1.1), Material.WALL))
    return joined(parts)


def along(*corners: tuple[float, float]) -> list[np.ndarray]:
    """Poses of a sensor every STEP_M along straight lines between corners, looking ahead."""
    poses = []
    for (x, y), (u, v) in pairwise(corners):
        heading, length = np.arctan2(v - y, u - x), np.hypot(u - x, v - y)
        for way in np.arange(0.0, length, STEP_M):
            poses.append(se3.from_yaw(heading, (x + way * np.cos(heading), y + way * np.sin(heading), HEIGHT_M)))
    return poses


def seen(world: Blocks, poses: list[np.ndarray], seed: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """What a sensor of 40 beams returns at each pose: points in its frame, and the pose."""
    scene, rng = Scene(world.triangles(), world.triangle_materials()), np.random.default_rng(seed)
    tilt, turn = np.meshgrid(_ELEVATIONS, _AZIMUTHS, indexing="ij")
    flat = np.stack([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)], axis=-1).reshape(-1, 3)
    for T_world_sensor in poses:
        rays = np.asarray(flat @ T_world_sensor[:3, :3].T, dtype=np.float32)
        ranges = scene.cast(T_world_sensor[:3, 3], rays).range_m
        hit = ranges < 60.0
        measured = ranges[hit] + rng.normal(0.0, NOISE_M, int(hit.sum()))
        yield (flat[hit] * measured[:, None]).astype(np.float32), T_world_sensor
