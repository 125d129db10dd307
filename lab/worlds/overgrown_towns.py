"""The test towns as real streets are: loose leaves, herbs along the ways, and the errors of a real recording.

Of the returns of the older towns 9 % are scatter, of a real street 35 % (`lab.realism`); their poses are exact,
and their sensor is without fault. The older drives stay as they are, for comparison.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lab.worlds.towns import SimulatedDrive
from lab.worlds.vegetation import hedge, herbs
from revisit.core.geometry import se3
from revisit.core.scan import Points
from revisit.evaluation.simulator import World
from revisit.evaluation.simulator.blocks import Floats, Material
from revisit.evaluation.simulator.lidar import SimulatedScan
from revisit.evaluation.simulator.vegetation import leaves

_LEAVES_FOR_ONE = 5
_LEAF_EDGE_M = (0.1, 0.3)
_LEAF_SPREAD_M = 0.3
_HERB_REACH_M = 7.0  # from the edge of the pavement
_HERBS_PER_M2 = 80.0
_HEDGE_SPACING_M, _HEDGE_LENGTH_M = 9.0, (3.0, 9.0)
_HERB_HEIGHT_M = (0.2, 1.4)
_PATCH_M = 25.0


@dataclass(frozen=True)
class OvergrownDrive(SimulatedDrive):
    """A drive through an overgrown town, recorded with errors.

    A pose is off by `pose_noise_m` and `pose_noise_deg` (standard deviation of each axis); the sensor looks
    `askew_deg` beside its poses; each beam measures ranges wrong by its own offset, `beam_offset_m` (standard
    deviation). The values are those of KITTI 00 (docs/explanation/simulator.md).
    """

    pose_noise_m: float = 0.015
    pose_noise_deg: float = 0.05
    askew_deg: float = 0.3
    beam_offset_m: float = 0.02

    def _world(self) -> World:
        return overgrown(super()._world(), self.seed)

    def _recorded(self, index: int, scan: SimulatedScan) -> tuple[Points, se3.Matrix4, int]:
        rng = np.random.default_rng([self.seed, 43, index])
        shift, turn = rng.normal(0.0, self.pose_noise_m, 3), rng.normal(0.0, self.pose_noise_deg, 3)
        jitter = se3.exp(np.concatenate([shift, np.radians(turn)]))
        offset = np.random.default_rng([self.seed, 47]).normal(0.0, self.beam_offset_m, 256)[scan.beam]
        stretch = 1.0 + offset / np.maximum(np.linalg.norm(scan.points, axis=1), 0.5)
        points = np.asarray(scan.points * stretch[:, None], dtype=np.float32)
        pose = scan.T_world_sensor @ se3.from_yaw(np.radians(self.askew_deg)) @ jitter
        return points, np.asarray(pose), scan.stamp_ns


def as_overgrown(drive: SimulatedDrive) -> OvergrownDrive:
    """The same drive through the same town, overgrown."""
    kept = {field.name: getattr(drive, field.name) for field in dataclasses.fields(SimulatedDrive)}
    return OvergrownDrive(**{**kept, "name": f"{drive.name}-overgrown"})


def overgrown(world: World, seed: int) -> World:
    """A town with more and smaller leaves where its leaves are, and herbs beside its streets."""
    rng = np.random.default_rng([seed, 53])
    green = world.materials == Material.LEAF
    middles = np.repeat(world.triangles[green].mean(axis=1), _LEAVES_FOR_ONE, axis=0).astype(np.float64)
    middles += rng.normal(0.0, _LEAF_SPREAD_M / 2, middles.shape)
    foliage = leaves(middles, rng.uniform(*_LEAF_EDGE_M, len(middles)), rng)
    feet = _feet(world, rng)
    low, high = _HERB_HEIGHT_M
    tall = low + (high - low) * _patches(feet[:, :2], rng)
    green_below = np.concatenate([herbs(feet, tall, rng), *_hedges(world, rng)])
    off_streets = world.ground.street_distance(green_below.mean(axis=1)[:, :2]) > world.ground.kerb
    grown = np.concatenate([foliage, green_below[off_streets]])
    triangles = np.concatenate([world.triangles[~green], grown])
    materials = np.concatenate([world.materials[~green], np.full(len(grown), Material.LEAF, np.uint8)])
    return dataclasses.replace(world, triangles=triangles, materials=materials)


def _hedges(world: World, rng: np.random.Generator) -> list[NDArray[np.float32]]:
    """Hedges and shrubs along the pavements, with gaps; none at crossings."""
    grown, aside = [], world.ground.kerb + 2.4
    for street in world.streets:
        arc = np.arange(0.0, street.length, _HEDGE_SPACING_M)
        arc = np.minimum(arc + rng.uniform(0.0, 3.0, len(arc)), street.length)
        for side in (-aside, aside):
            spots, yaw = street.beside(arc, np.full(len(arc), side)), street.heading(arc, 6.0)
            clear = (world.ground.street_distance(spots) > aside - 0.5) & (rng.random(len(arc)) < 0.9)
            for foot, along in zip(world.ground.on(spots[clear]), yaw[clear], strict=True):
                grown.append(hedge(foot, float(along), rng.uniform(*_HEDGE_LENGTH_M), rng))
    return grown


def _feet(world: World, rng: np.random.Generator) -> Floats:
    """Points (n, 3) of the ground beside the pavements, in patches."""
    middle = np.concatenate([street.sampled(1.0).points for street in world.streets])
    reach = world.ground.kerb + 2.0 + _HERB_REACH_M
    low, high = middle.min(axis=0) - reach, middle.max(axis=0) + reach
    spots = rng.uniform(low, high, (int(np.prod(high - low) * _HERBS_PER_M2), 2))
    distance = world.ground.street_distance(spots)
    grows = (distance > world.ground.kerb + 0.2) & (distance < reach)
    spots = spots[grows]
    spots = spots[rng.random(len(spots)) < _patches(spots, rng)]
    return world.ground.on(spots)


def _patches(spots: Floats, rng: np.random.Generator) -> NDArray[np.float64]:
    """A value (n,) of 0 to 1 that changes from patch to patch."""
    directions, phases = rng.normal(size=(2, 4)), rng.uniform(0.0, 2 * np.pi, 4)
    waves = np.sin(2 * np.pi / _PATCH_M * spots @ directions + phases).mean(axis=1)
    return np.asarray(np.clip(0.6 + waves, 0.0, 1.0))
