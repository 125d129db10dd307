"""A procedural town along given streets: ground and kerbs, houses, gardens, trees, street furniture, parking, traffic."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from evaluation.simulator import vegetation
from evaluation.simulator.blocks import Blocks, Floats, Material, block, joined
from evaluation.simulator.buildings import STYLES, Facade, build_house
from evaluation.simulator.paths import Path
from evaluation.simulator.traffic import ParkingSlots, Traffic, random_traffic


@dataclass(frozen=True)
class TownPlan:
    """What a town is like. Lengths in metres, shares in 0..1, densities per kilometre of street."""

    kerb: float = 5.2
    pavement: float = 2.2
    kerb_height: float = 0.12
    relief: float = 0.8
    vacant_lots: float = 0.16
    street_tree_spacing: float = 14.0
    garden_trees_per_hectare: float = 45.0
    parked_share: float = 0.45
    moving_cars_per_km: float = 5.0
    people_per_km: float = 8.0
    reach: float = 60.0


@dataclass(frozen=True)
class Ground:
    """Height of the ground: gentle waves, a kerb beside every street. amplitude (k,) m, wave (k, 2) rad/m, phase (k,)."""

    amplitude: Floats
    wave: Floats
    phase: Floats
    street_tree: cKDTree = field(repr=False)
    kerb: float
    kerb_height: float

    def terrain(self, xy: Floats) -> Floats:
        """Height (n,) of the street surface at `xy` (n, 2)."""
        return np.asarray(np.sin(xy @ self.wave.T + self.phase) @ self.amplitude)

    def height(self, xy: Floats) -> Floats:
        """Height (n,) with the kerb: pavements and gardens lie higher than streets."""
        return self.terrain(xy) + np.where(self.street_distance(xy) > self.kerb, self.kerb_height, 0.0)

    def street_distance(self, xy: Floats) -> Floats:
        """Distance (n,) to the middle of the nearest street."""
        return np.asarray(self.street_tree.query(xy, distance_upper_bound=200.0)[0])

    def on(self, xy: Floats) -> Floats:
        """The points (n, 3) of the ground at `xy` (n, 2)."""
        return np.column_stack([xy, self.height(xy)])


@dataclass(frozen=True)
class World:
    """A town: its fixed triangles (t, 3, 3) with materials (t,), and what changes or moves in it."""

    triangles: NDArray[np.float32]
    materials: NDArray[np.uint8]
    ground: Ground
    streets: tuple[Path, ...]
    parking: ParkingSlots
    traffic: Traffic


def build_city(streets: list[Path], seed: int, plan: TownPlan | None = None, drive: Path | None = None) -> World:
    """A town along `streets`; nothing but moving traffic stands in the way of `drive`. The same seed, the same town."""
    plan = plan or TownPlan()
    rng = np.random.default_rng([seed, 1])
    ground = _lay_ground(streets, plan, rng)
    plot = _Plot(streets, drive, plan)
    solids: list[Blocks] = []
    foliage: list[NDArray[np.float32]] = []
    for street in streets:
        _line_with_houses(street, ground, plot, plan, rng, solids, foliage)
        _furnish(street, ground, plot, plan, rng, solids, foliage)
    _plant_gardens(ground, plot, plan, rng, solids, foliage)
    blocks, leaves = joined(solids), np.concatenate(foliage) if foliage else np.zeros((0, 3, 3), np.float32)
    soil, soil_materials = _ground_mesh(ground, plot, plan, rng)
    return World(
        triangles=np.concatenate([soil, blocks.triangles(), leaves]),
        materials=np.concatenate(
            [soil_materials, blocks.triangle_materials(), np.full(len(leaves), Material.LEAF, np.uint8)]
        ),
        ground=ground, streets=tuple(streets), parking=_parking(streets, ground, plot, plan, seed, rng),
        traffic=random_traffic(streets, plan.moving_cars_per_km, plan.people_per_km, plan.kerb + 1.2, rng),
    )  # fmt: skip


def _lay_ground(streets: list[Path], plan: TownPlan, rng: np.random.Generator) -> Ground:
    length = np.array([420.0, 260.0, 150.0])
    direction = rng.uniform(0, 2 * np.pi, 3)
    wave = (2 * np.pi / length)[:, None] * np.stack([np.cos(direction), np.sin(direction)], axis=1)
    amplitude = plan.relief * np.array([0.6, 0.3, 0.1])
    middle = np.concatenate([street.sampled(0.5).points for street in streets])
    return Ground(amplitude, wave, rng.uniform(0, 2 * np.pi, 3), cKDTree(middle), plan.kerb, plan.kerb_height)


class _Plot:
    """A 1 m raster of what ground is already used."""

    def __init__(self, streets: list[Path], drive: Path | None, plan: TownPlan) -> None:
        points = np.concatenate([street.sampled(0.5).points for street in streets])
        margin = plan.reach + 10.0
        self.low = np.floor(points.min(axis=0) - margin)
        self.shape = tuple(np.ceil(points.max(axis=0) + margin - self.low).astype(int))
        rows, columns = np.indices(self.shape)
        self.centres = np.stack([rows.ravel(), columns.ravel()], axis=1) + self.low + 0.5
        distance = cKDTree(points).query(self.centres, distance_upper_bound=margin + 40.0)[0]
        self.street_distance = distance.reshape(self.shape)
        self.taken = self.street_distance < plan.kerb + plan.pavement * 0.5
        self.driven = cKDTree(drive.sampled(0.5).points) if drive is not None else None

    def cells(self, xy: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Raster indices of `xy` (n, 2), clipped to the raster."""
        index = np.clip((xy - self.low).astype(np.int64), 0, np.array(self.shape) - 1)
        return index[:, 0], index[:, 1]

    def claim(self, xy: Floats) -> bool:
        """Take the cells under `xy` if all of them are free and out of the way of the drive."""
        cells = self.cells(xy)
        if self.taken[cells].any() or not self.clear_of_drive(xy, 3.2).all():
            return False
        self.taken[cells] = True
        return True

    def clear_of_drive(self, xy: Floats, margin: float) -> NDArray[np.bool_]:
        """Which of `xy` (n, 2) are at least `margin` metres from where the sensor will pass."""
        if self.driven is None:
            return np.ones(len(xy), dtype=bool)
        return np.asarray(self.driven.query(xy)[0] > margin)


def _line_with_houses(
    street: Path, ground: Ground, plot: _Plot, plan: TownPlan, rng: np.random.Generator,
    solids: list[Blocks], foliage: list[NDArray[np.float32]],
) -> None:  # fmt: skip
    """Rows of houses on both sides; the style holds for a stretch of street, as in a real quarter."""
    for side in (-1.0, 1.0):
        arc, style, until, setback = 4.0, STYLES[0], -1.0, 0.0
        while arc < street.length - 4.0:
            if arc > until:
                style = STYLES[int(rng.integers(len(STYLES)))]
                until, setback = arc + rng.uniform(35.0, 90.0), rng.uniform(*style.setback)
            width, depth = rng.uniform(*style.width), rng.uniform(*style.depth)
            front = plan.kerb + plan.pavement + setback + rng.uniform(0.0, 0.4)
            if rng.random() > plan.vacant_lots:
                _build_lot(street, arc + width / 2, side, front, style, (width, depth), ground, plot, rng, solids, foliage)
            gap = rng.choice([0.25, rng.uniform(2.0, 6.0)], p=[0.45, 0.55])
            arc += width + gap


def _build_lot(
    street: Path, arc: float, side: float, front: float, style: Facade, size: tuple[float, float], ground: Ground,
    plot: _Plot, rng: np.random.Generator, solids: list[Blocks], foliage: list[NDArray[np.float32]],
) -> None:  # fmt: skip
    """One house, and a hedge, fence or nothing between its garden and the pavement."""
    width, depth = size
    heading = float(street.heading(arc, span=width))
    yaw = heading if side > 0 else heading + np.pi
    ahead, inward = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    corner = street.at(arc) + inward * front
    across, deep = np.meshgrid(np.linspace(-width / 2, width / 2, 14), np.linspace(0.0, depth, 12))
    footprint = corner + across.reshape(-1, 1) * ahead + deep.reshape(-1, 1) * inward
    if not plot.claim(footprint):
        return
    level = float(ground.height(corner[None])[0])
    solids.append(build_house(style, width, depth, rng).placed([*corner, level], yaw))
    kerb_gap = front - (ground.kerb + 2.2)
    if kerb_gap > 1.5:
        ends = ground.on(corner - inward * (kerb_gap - 0.6) + np.outer([-width / 2, width * 0.3], ahead))
        if plot.clear_of_drive(ends[:, :2], 3.0).all():
            _bound_garden(ends, rng, solids, foliage)


def _bound_garden(
    ends: Floats, rng: np.random.Generator, solids: list[Blocks], foliage: list[NDArray[np.float32]]
) -> None:
    choice = rng.random()
    if choice < 0.45:
        foliage.append(vegetation.hedge(ends[0], ends[1], rng.uniform(0.9, 1.9), rng))
    elif choice < 0.8:
        solids.append(vegetation.fence(ends[0], ends[1], rng.uniform(0.9, 1.5)))


def _furnish(
    street: Path, ground: Ground, plot: _Plot, plan: TownPlan, rng: np.random.Generator,
    solids: list[Blocks], foliage: list[NDArray[np.float32]],
) -> None:  # fmt: skip
    """Street trees on some stretches, lamps, signs, bollards and bins on the pavement."""
    for side in (-1.0, 1.0):
        planted = rng.random() < 0.6
        for arc in np.arange(rng.uniform(2, 10), street.length, plan.street_tree_spacing / 2):
            spot = street.beside(arc + rng.uniform(-2, 2), side * (plan.kerb + rng.uniform(0.5, 1.0)))
            if ground.street_distance(spot[None])[0] < plan.kerb + 0.3 or not plot.clear_of_drive(spot[None], 2.5)[0]:
                continue
            base, choice = ground.on(spot[None])[0], rng.random()
            if planted and choice < 0.42:
                trunk, leaves = vegetation.tree(base, rng)
                solids.append(trunk)
                foliage.append(leaves)
            elif choice < 0.75:
                solids.append(_furniture(rng).placed(base, float(street.heading(arc)) + (0.0 if side > 0 else np.pi)))


def _furniture(rng: np.random.Generator) -> Blocks:
    choice = rng.random()
    if choice < 0.4:
        height = rng.uniform(5.0, 8.0)
        arm = block((0, -0.8, height), (0.2, 1.8, 0.15), Material.METAL)
        return joined([block((0, 0, -0.2), (0.18, 0.18, height + 0.2), Material.METAL, (0.6, 0.6)), arm])
    if choice < 0.7:
        post = block((0, 0, -0.2), (0.08, 0.08, 2.8), Material.METAL)
        return joined([post, block((0, 0, 2.0), (0.06, 0.6, 0.6), Material.METAL)])
    if choice < 0.85:
        return block((0, 0, -0.1), (0.6, 0.55, 1.15), Material.METAL, (0.9, 0.9))
    return block((0, 0, -0.1), (0.8, 0.4, 1.6), Material.METAL)


def _plant_gardens(
    ground: Ground, plot: _Plot, plan: TownPlan, rng: np.random.Generator,
    solids: list[Blocks], foliage: list[NDArray[np.float32]],
) -> None:  # fmt: skip
    """Trees and shrubs on the ground that nothing else took."""
    free = np.argwhere(~plot.taken & (plot.street_distance < plan.reach * 0.7))
    count = int(len(free) / 10_000.0 * plan.garden_trees_per_hectare)
    chosen = free[rng.choice(len(free), size=min(2 * count, len(free)), replace=False)]
    spots = chosen + plot.low + rng.uniform(0.2, 0.8, chosen.shape)
    spots = spots[plot.clear_of_drive(spots, 5.0)]
    for index, base in enumerate(ground.on(spots)):
        if index % 2:
            foliage.append(vegetation.bush(base, rng))
            continue
        trunk, leaves = vegetation.tree(base, rng)
        solids.append(trunk)
        foliage.append(leaves)


def _ground_mesh(
    ground: Ground, plot: _Plot, plan: TownPlan, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Fine cells beside the streets, where the kerb is, coarse ones elsewhere."""
    fine = _lattice(ground, plot.low, 1.0, plot.shape, plot.street_distance, (0.0, 14.0), plan, rng)
    step = 4
    coarse_distance = plot.street_distance[::step, ::step]
    shape = (coarse_distance.shape[0], coarse_distance.shape[1])
    coarse = _lattice(ground, plot.low, float(step), shape, coarse_distance, (10.0, 1e9), plan, rng)
    return np.concatenate([fine[0], coarse[0]]), np.concatenate([fine[1], coarse[1]])


def _lattice(
    ground: Ground, low: Floats, cell: float, shape: tuple[int, ...], distance: Floats, band: tuple[float, float],
    plan: TownPlan, rng: np.random.Generator,
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:  # fmt: skip
    rows, columns = np.indices((shape[0] + 1, shape[1] + 1))
    xy = np.stack([rows, columns], axis=-1).reshape(-1, 2) * cell + low
    street = ground.street_distance(xy)
    z = ground.height(xy) + np.where(street > plan.kerb + plan.pavement, rng.normal(0.0, 0.035, len(xy)), 0.0)
    corners = np.column_stack([xy, z]).reshape(shape[0] + 1, shape[1] + 1, 3)
    cells = np.argwhere((distance >= band[0]) & (distance < band[1]))
    i, j = cells[:, 0], cells[:, 1]
    a, b, c, d = corners[i, j], corners[i + 1, j], corners[i + 1, j + 1], corners[i, j + 1]
    triangles = np.stack([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)], axis=1).reshape(-1, 3, 3)
    grass = distance[i, j] > plan.kerb + plan.pavement
    return triangles.astype(np.float32), np.repeat(np.where(grass, Material.GRASS, Material.GROUND).astype(np.uint8), 2)


def _parking(
    streets: list[Path], ground: Ground, plot: _Plot, plan: TownPlan, seed: int, rng: np.random.Generator
) -> ParkingSlots:
    """Slots at both kerbs, away from crossings and from the way of the drive."""
    spots, yaws = [np.zeros((0, 2))], [np.zeros(0)]
    for street in streets:
        for side in (-1.0, 1.0):
            arcs = np.arange(8.0, street.length - 8.0, 6.2)
            spots.append(street.beside(arcs, np.full(len(arcs), side * (plan.kerb - 1.05))))
            yaws.append(street.heading(arcs) + (0.0 if side < 0 else np.pi))
    xy, yaw = np.concatenate(spots), np.concatenate(yaws)
    alone = ground.street_distance(xy) > plan.kerb - 1.4
    free = alone & plot.clear_of_drive(xy, 2.3) & (rng.random(len(xy)) < 0.85)
    position = np.column_stack([xy, ground.terrain(xy)])[free]
    return ParkingSlots(position, yaw[free], plan.parked_share, seed)
