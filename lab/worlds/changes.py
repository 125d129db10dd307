"""Changes of a town within a year: trees are felled or lose leaves, houses come down, containers stand on the verge."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.evaluation.simulator.blocks import Blocks, Floats, Material, block, joined
from revisit.evaluation.simulator.city import World


@dataclass(frozen=True)
class Changes:
    """Shares in 0..1, densities per kilometre of street.

    `felled` of the area loses its trees and hedges, `bare` of all remaining leaves are gone; `demolished_per_km` sites
    of 12 m radius are cleared; `containers_per_km` are put beside the street.
    """

    felled: float = 0.15
    bare: float = 0.3
    demolished_per_km: float = 2.0
    containers_per_km: float = 8.0


def changed(world: World, seed: int, changes: Changes = Changes()) -> World:
    """The town later: its streets, ground and most houses are the same, other cars are parked. Same seed, same town."""
    rng = np.random.default_rng([seed, 91])
    length_km = sum(street.length for street in world.streets) / 1000.0
    kept = ~_leafless(world, changes, rng) & ~_cleared(world, rng.poisson(changes.demolished_per_km * length_km), rng)
    new = _containers(world, rng.poisson(changes.containers_per_km * length_km), rng)
    return dataclasses.replace(
        world,
        triangles=np.concatenate([world.triangles[kept], new.triangles()]),
        materials=np.concatenate([world.materials[kept], new.triangle_materials()]),
        parking=dataclasses.replace(world.parking, seed=seed + 1),
    )


def _leafless(world: World, changes: Changes, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which triangles (t,) are leaves that are gone: those on felled ground, and some of all others."""
    leaf = world.materials == Material.LEAF
    cell = np.floor(world.triangles[:, 0, :2] / 5.0).astype(np.int64)
    _, patch = np.unique(cell, axis=0, return_inverse=True)
    felled = (rng.random(patch.max() + 1) < changes.felled)[patch.ravel()]
    return np.asarray(leaf & (felled | (rng.random(len(leaf)) < changes.bare)))


def _cleared(world: World, sites: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which triangles (t,) stood on demolished sites; the ground stays."""
    centres = _beside_streets(world, sites, (10.0, 18.0), rng)
    if len(centres) == 0:
        return np.zeros(len(world.materials), dtype=bool)
    standing = (world.materials != Material.GROUND) & (world.materials != Material.GRASS)
    distance = cKDTree(centres).query(world.triangles.mean(axis=1)[:, :2])[0]
    return np.asarray(standing & (distance < 12.0))


def _containers(world: World, count: int, rng: np.random.Generator) -> Blocks:
    """Containers and cabins on the verge, out of the way of cars."""
    spots = world.ground.on(_beside_streets(world, count, (7.5, 9.5), rng))
    clear = world.ground.street_distance(spots[:, :2]) > 7.0
    parts = []
    for spot in spots[clear]:
        size = (rng.uniform(3.0, 6.0), 2.4, rng.uniform(2.2, 5.2))
        parts.append(block((0, 0, -0.3), size, Material.METAL).placed(spot, rng.uniform(0, np.pi)))
    return joined(parts)


def _beside_streets(world: World, count: int, offset_m: tuple[float, float], rng: np.random.Generator) -> Floats:
    """Random positions (count, 2), on either side of random streets."""
    spots = [np.zeros(2)] * 0
    for _ in range(count):
        street = world.streets[int(rng.integers(len(world.streets)))]
        side = rng.choice([-1.0, 1.0]) * rng.uniform(*offset_m)
        spots.append(street.beside(np.array([rng.uniform(0, street.length)]), np.array([side]))[0])
    return np.array(spots).reshape(-1, 2)
