"""A procedural town along given streets: ground, kerbs, houses, gardens, trees, street furniture, parking, traffic."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.evaluation.simulator import vegetation
from revisit.evaluation.simulator.blocks import Blocks, Floats, Material, block, joined
from revisit.evaluation.simulator.buildings import STYLES, Facade, build_house
from revisit.evaluation.simulator.paths import Path
from revisit.evaluation.simulator.structure import Solids, Structure
from revisit.evaluation.simulator.traffic import ParkingSlots, Traffic, random_traffic


@dataclass(frozen=True)
class TownPlan:
    """Parameters of a town. Lengths in metres, shares in 0..1, densities per kilometre of street."""

    kerb: float = 4.7
    pavement: float = 2.0
    kerb_height: float = 0.12
    relief: float = 0.8
    vacant_lots: float = 0.18
    street_tree_spacing: float = 14.0
    garden_trees_per_hectare: float = 80.0
    parked_share: float = 0.65
    moving_cars_per_km: float = 5.0
    people_per_km: float = 8.0
    reach: float = 60.0


@dataclass(frozen=True)
class Ground:
    """Height of the ground: gentle waves, and a kerb beside every street.

    amplitude (k,) metres, wave (k, 2) radians per metre, phase (k,) radians; kerb its distance from mid-street, metres.
    """

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
class World(Structure):
    """A town: its fixed structure, and its changing and moving parts."""

    ground: Ground
    streets: tuple[Path, ...]
    parking: ParkingSlots
    traffic: Traffic


def build_city(streets: list[Path], seed: int, plan: TownPlan | None = None, drive: Path | None = None) -> World:
    """A town along `streets`; nothing but moving traffic stands in the way of `drive`. The same seed, the same town."""
    plan = plan or TownPlan()
    rng = np.random.default_rng([seed, 1])
    site = _Site(plan, _lay_ground(streets, plan, rng), _Plot(streets, drive, plan), rng)
    for street in streets:
        _line_with_houses(street, site)
        _furnish(street, site)
    _plant_gardens(site)
    fixed = _fixed(site)
    return World(
        triangles=fixed.triangles, materials=fixed.materials, ground=site.ground, streets=tuple(streets),
        parking=_parking(streets, site, seed),
        traffic=random_traffic(streets, plan.moving_cars_per_km, plan.people_per_km, plan.kerb + 1.2, rng),
    )  # fmt: skip


def _fixed(site: _Site) -> Structure:
    """Everything that stays, the ground first."""
    soil, soil_materials = _ground_mesh(site)
    built = site.solids.built()
    return Structure(np.concatenate([soil, built.triangles]), np.concatenate([soil_materials, built.materials]))


def _lay_ground(streets: list[Path], plan: TownPlan, rng: np.random.Generator) -> Ground:
    length = np.array([420.0, 260.0, 150.0])
    direction = rng.uniform(0, 2 * np.pi, 3)
    wave = (2 * np.pi / length)[:, None] * np.stack([np.cos(direction), np.sin(direction)], axis=1)
    amplitude = plan.relief * np.array([0.6, 0.3, 0.1])
    middle = np.concatenate([street.sampled(0.5).points for street in streets])
    return Ground(amplitude, wave, rng.uniform(0, 2 * np.pi, 3), cKDTree(middle), plan.kerb, plan.kerb_height)


class _Plot:
    """A 1 m raster of the ground in use."""

    def __init__(self, streets: list[Path], drive: Path | None, plan: TownPlan) -> None:
        points = np.concatenate([street.sampled(0.5).points for street in streets])
        margin = plan.reach + 10.0
        self.low = np.floor(points.min(axis=0) - margin)
        self.shape = tuple(np.ceil(points.max(axis=0) + margin - self.low).astype(int))
        rows, columns = np.indices(self.shape)
        centres = np.stack([rows.ravel(), columns.ravel()], axis=1) + self.low + 0.5
        distance = cKDTree(points).query(centres, distance_upper_bound=margin + 40.0)[0]
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


@dataclass(frozen=True)
class _Site:
    """A town being built: its plan, its ground, the free plots, and their buildings so far."""

    plan: TownPlan
    ground: Ground
    plot: _Plot
    rng: np.random.Generator
    solids: Solids = field(default_factory=Solids)


@dataclass(frozen=True)
class _House:
    """A style with the size it is built in, metres."""

    style: Facade
    width: float
    depth: float


def _line_with_houses(street: Path, site: _Site) -> None:
    """Rows of houses on both sides; the style holds for a stretch of street, as in a real quarter."""
    for side in (-1.0, 1.0):
        arc, style, until, setback = 4.0, STYLES[0], -1.0, 0.0
        while arc < street.length - 4.0:
            if arc > until:
                style = STYLES[int(site.rng.integers(len(STYLES)))]
                until, setback = arc + site.rng.uniform(35.0, 90.0), site.rng.uniform(*style.setback)
            house = _House(style, site.rng.uniform(*style.width), site.rng.uniform(*style.depth))
            front = site.plan.kerb + site.plan.pavement + setback + site.rng.uniform(0.0, 0.4)
            if site.rng.random() > site.plan.vacant_lots:
                _build_lot(street, arc + house.width / 2, side, front, house, site)
            gap = site.rng.choice([0.25, site.rng.uniform(2.0, 6.0)], p=[0.45, 0.55])
            arc += house.width + gap


def _build_lot(street: Path, arc: float, side: float, front: float, house: _House, site: _Site) -> None:
    """One house, and a hedge, fence or nothing between its garden and the pavement."""
    width, depth = house.width, house.depth
    heading = float(street.heading(arc, span=width))
    yaw = heading if side > 0 else heading + np.pi
    ahead, inward = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    corner = street.at(arc) + inward * front
    across, deep = np.meshgrid(np.linspace(-width / 2, width / 2, 14), np.linspace(0.0, depth, 12))
    footprint = corner + across.reshape(-1, 1) * ahead + deep.reshape(-1, 1) * inward
    if not site.plot.claim(footprint):
        return
    level = float(site.ground.height(corner[None])[0])
    site.solids.blocks.append(build_house(house.style, width, depth, site.rng).placed([*corner, level], yaw))
    kerb_gap = front - (site.ground.kerb + site.plan.pavement)
    if kerb_gap > 1.5:
        ends = site.ground.on(corner - inward * (kerb_gap - 0.6) + np.outer([-width / 2, width * 0.3], ahead))
        if site.plot.clear_of_drive(ends[:, :2], 3.0).all():
            _bound_garden(ends, site)


def _bound_garden(ends: Floats, site: _Site) -> None:
    choice = site.rng.random()
    if choice < 0.55:
        site.solids.add(vegetation.hedge(ends[0], ends[1], site.rng.uniform(0.9, 1.9), site.rng), Material.LEAF)
    elif choice < 0.85:
        site.solids.blocks.append(vegetation.fence(ends[0], ends[1], site.rng.uniform(0.9, 1.5)))


def _furnish(street: Path, site: _Site) -> None:
    """Street trees on some stretches, lamps, signs, bollards and bins on the pavement."""
    for side in (-1.0, 1.0):
        trees = 0.42 if site.rng.random() < 0.6 else 0.0
        for arc in np.arange(site.rng.uniform(2, 10), street.length, site.plan.street_tree_spacing / 2):
            offset = side * (site.plan.kerb + site.rng.uniform(0.5, 1.0))
            spot = street.beside(arc + site.rng.uniform(-2, 2), offset)[None]
            on_street = site.ground.street_distance(spot)[0] < site.plan.kerb + 0.3
            if on_street or not site.plot.clear_of_drive(spot, 2.5)[0]:
                continue
            base, choice = site.ground.on(spot)[0], site.rng.random()
            if choice < trees:
                _plant_tree(base, site)
            elif choice < 0.75:
                yaw = float(street.heading(arc)) + (0.0 if side > 0 else np.pi)
                site.solids.blocks.append(_furniture(site.rng).placed(base, yaw))


def _plant_tree(base: Floats, site: _Site) -> None:
    trunk, leaves = vegetation.tree(base, site.rng)
    site.solids.blocks.append(trunk)
    site.solids.add(leaves, Material.LEAF)


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


def _plant_gardens(site: _Site) -> None:
    """Trees and shrubs on the ground that nothing else took."""
    free = np.argwhere(~site.plot.taken & (site.plot.street_distance < site.plan.reach * 0.7))
    count = int(len(free) / 10_000.0 * site.plan.garden_trees_per_hectare)
    chosen = free[site.rng.choice(len(free), size=min(2 * count, len(free)), replace=False)]
    spots = chosen + site.plot.low + site.rng.uniform(0.2, 0.8, chosen.shape)
    spots = spots[site.plot.clear_of_drive(spots, 5.0)]
    for index, base in enumerate(site.ground.on(spots)):
        if index % 2:
            site.solids.add(vegetation.bush(base, site.rng), Material.LEAF)
        else:
            _plant_tree(base, site)


def _ground_mesh(site: _Site) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Fine cells beside the streets, where the kerb is, coarse ones elsewhere."""
    distance, step = site.plot.street_distance, 4
    fine = _lattice(site, 1.0, distance, (0.0, 14.0))
    coarse = _lattice(site, float(step), distance[::step, ::step], (10.0, 1e9))
    return np.concatenate([fine[0], coarse[0]]), np.concatenate([fine[1], coarse[1]])


def _lattice(
    site: _Site, cell: float, distance: Floats, band: tuple[float, float]
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Two triangles a cell where the distance (rows, columns) to the street lies within `band`, metres."""
    rows, columns = np.indices((distance.shape[0] + 1, distance.shape[1] + 1))
    xy = np.stack([rows, columns], axis=-1).reshape(-1, 2) * cell + site.plot.low
    garden_from = site.plan.kerb + site.plan.pavement
    rough = np.where(site.ground.street_distance(xy) > garden_from, site.rng.normal(0.0, 0.06, len(xy)), 0.0)
    corners = np.column_stack([xy, site.ground.height(xy) + rough]).reshape(*rows.shape, 3)
    i, j = np.nonzero((distance >= band[0]) & (distance < band[1]))
    a, b, c, d = corners[i, j], corners[i + 1, j], corners[i + 1, j + 1], corners[i, j + 1]
    triangles = np.stack([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)], axis=1).reshape(-1, 3, 3)
    kind = np.where(distance[i, j] > garden_from, Material.GRASS, Material.GROUND).astype(np.uint8)
    return triangles.astype(np.float32), np.repeat(kind, 2)


def _parking(streets: list[Path], site: _Site, seed: int) -> ParkingSlots:
    """Slots at both kerbs, away from crossings and from the way of the drive."""
    kerb, spots, yaws = site.plan.kerb, [np.zeros((0, 2))], [np.zeros(0)]
    for street in streets:
        for side in (-1.0, 1.0):
            arcs = np.arange(8.0, street.length - 8.0, 6.2)
            spots.append(street.beside(arcs, np.full(len(arcs), side * (kerb - 1.05))))
            yaws.append(street.heading(arcs) + (0.0 if side < 0 else np.pi))
    xy, yaw = np.concatenate(spots), np.concatenate(yaws)
    alone = site.ground.street_distance(xy) > kerb - 1.4
    free = alone & site.plot.clear_of_drive(xy, 2.9) & (site.rng.random(len(xy)) < 0.85)
    position = np.column_stack([xy, site.ground.terrain(xy)])[free]
    return ParkingSlots(position, yaw[free], site.plan.parked_share, seed)
