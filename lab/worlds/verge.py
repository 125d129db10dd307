"""A world grown beside any way; built unlike the towns of `evaluation.simulator`.

Nothing is on a grid: houses of random footprints stand at random distances and angles, hedges, walls and cars line the
verge, trees are clouds of leaves, the ground is rough. The style changes slowly along the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from lab.worlds import vegetation
from lab.worlds.open_world import OpenSolids, OpenWorld
from lab.worlds.relief import Waves, ground_triangles
from revisit.evaluation.simulator.blocks import Blocks, Floats, Material, block, joined
from revisit.evaluation.simulator.paths import Path

Range = tuple[float, float]

_FORGOTTEN_M = 40.0  # a way that comes back after this far meets the verge that grew at the first pass
_SAME_WAY_M = 7.0
_BLADES_PER_METRE = 400


@dataclass(frozen=True)
class Style:
    """How a verge looks: ranges within which it changes along the way. Lengths in metres, shares in 0..1.

    built: share of lots with a house; green: how much grows; setback and height of houses; length and depth of them;
    lot: distance of houses over their length; askew: radians. Where houses are `touching` only the way keeps them off.
    """

    built: Range = (0.1, 0.95)
    green: Range = (0.1, 1.0)
    setback: Range = (5.5, 20.0)
    height: Range = (3.5, 17.0)
    length: Range = (6.0, 28.0)
    depth: Range = (6.0, 16.0)
    lot: Range = (0.8, 1.4)
    askew: float = 0.12
    touching: bool = False


MIXED = Style()
ROW_HOUSES = Style((0.75, 0.75), (0.7, 0.7), (9.0, 9.2), (6.0, 6.0), (11.0, 14.0), (9.0, 9.0), (1.2, 1.35), 0.02)
CANYON = Style((1.0, 1.0), (0.12, 0.12), (7.0, 7.2), (11.0, 11.0), (11.0, 14.0), (9.0, 9.0), (1.0, 1.0), 0.02, True)
WOODS = Style((0.1, 0.14), (1.1, 1.5), (9.0, 11.0), (4.0, 6.0))


def grow(way: Path, style: Style, seed: int) -> OpenWorld:
    """The world beside `way`. The same arguments give the same world."""
    verge = _Verge(way, style, seed)
    for side in (1, -1):
        verge.build_houses(side)
        verge.line_the_way(side)
        verge.plant_trees(side)
        verge.sow(side)
    return verge.finished()


def varying(arc: Floats, period_m: float, bounds: Range, rng: np.random.Generator) -> Floats:
    """A value (n,) within `bounds` that changes slowly along arc lengths (n,)."""
    phases = rng.uniform(0, 2 * np.pi, 3)
    waves = sum(np.sin(2 * np.pi * arc / (period_m * f) + p) for f, p in zip((1.0, 0.6, 0.37), phases, strict=True)) / 3
    return np.asarray(bounds[0] + (bounds[1] - bounds[0]) * (0.5 + 0.5 * np.clip(1.5 * waves, -1, 1)))


class _Verge:
    """The world while it grows: the structure so far, and the way that must stay free."""

    def __init__(self, way: Path, style: Style, seed: int) -> None:
        self._rng = np.random.default_rng([seed, 5])
        self._way, self._style = way.sampled(1.0), style
        self._tree = cKDTree(self._way.points)
        self._yaw = self._way.heading(self._way.arc, 6.0)
        self._ground = Waves.random(self._rng)
        self._solids, self._houses = OpenSolids(), list[tuple[Floats, float]]()
        self._clear = self._rng.uniform(4.3, 6.0)
        self._grown = _meets_itself(self._way, self._tree)
        arc, rng = self._way.arc, self._rng
        self._built, self._green = varying(arc, 400.0, style.built, rng), varying(arc, 300.0, style.green, rng)
        self._setback, self._height = varying(arc, 260.0, style.setback, rng), varying(arc, 500.0, style.height, rng)

    def build_houses(self, side: int) -> None:
        """Houses on one side, where no house stands yet and the way stays free."""
        rng, style, at = self._rng, self._style, 0
        while at < len(self._yaw) - 2:
            length, depth = rng.uniform(*style.length), rng.uniform(*style.depth)
            step = max(4, int(length * rng.uniform(*style.lot)))
            middle = min(len(self._yaw) - 1, at + step // 2)
            centre = self._beside(middle, side * (self._setback[middle] * rng.uniform(0.9, 1.15) + depth / 2))
            if not self._grown[middle] and rng.random() < self._built[middle] and self._free(centre, length, depth):
                yaw = self._yaw[middle] + rng.normal(scale=style.askew)
                house = _house(length, depth, max(2.8, self._height[middle] * rng.uniform(0.8, 1.25)), side, rng)
                self._solids.blocks.append(house.placed(self._on(centre, -1.0), float(yaw)))
                self._houses.append((centre, 0.5 * max(length, depth)))
            at += step

    def line_the_way(self, side: int) -> None:
        """Hedges, walls, poles and parking along one side."""
        rng, at = self._rng, 0
        while at < len(self._yaw) - 12:
            length = rng.uniform(4, 20)
            middle = min(len(self._yaw) - 1, at + int(length) // 2)
            centre = self._beside(middle, side * (self._clear + rng.uniform(0.3, 2.5)))
            if not self._grown[middle] and self._tree.query(centre)[0] > self._clear - 0.2:
                self._line(centre, middle, side, length)
            at += int(length)

    def plant_trees(self, side: int) -> None:
        """Trees and bushes, most of them near the way."""
        for at in np.flatnonzero(self._rng.random(len(self._yaw)) < 0.6 * self._green).tolist():
            centre = self._beside(at, side * (self._clear + 0.6 + self._rng.gamma(1.3, 4.0)))
            if not self._grown[at] and self._free(centre, 1.0, 1.0):
                self._solids.add(*vegetation.plant(self._on(centre), self._rng))

    def sow(self, side: int) -> None:
        """Grass and herbs in patches from the edge of the way to 14 m beside it, higher and lower by turns."""
        arc, rng = self._way.arc, self._rng
        share = np.clip(varying(arc, 70.0, (-0.4, 1.4), rng) * self._green, 0.0, 1.0)
        lushness = varying(arc, 45.0, (0.1, 0.9), rng)
        at = rng.choice(len(arc), int(_BLADES_PER_METRE * share.sum()), p=share / max(float(share.sum()), 1e-9))
        left = side * (self._clear + rng.uniform(-1.2, 10.0, len(at)) ** 2 / 10.0 + rng.uniform(-0.5, 0.5, len(at)))
        yaw = self._yaw[at]
        along, across = np.stack([np.cos(yaw), np.sin(yaw)], 1), np.stack([-np.sin(yaw), np.cos(yaw)], 1)
        spots = self._way.points[at] + left[:, None] * across + rng.uniform(-0.5, 0.5, (len(at), 1)) * along
        spots, high = (part[self._tree.query(spots)[0] > self._clear - 1.5] for part in (spots, lushness[at]))
        feet = np.column_stack([spots, self._ground.terrain(spots)])
        self._solids.add(vegetation.herbs(feet, high, rng), Material.LEAF)

    def finished(self) -> OpenWorld:
        """The world with its ground."""
        self._solids.add(ground_triangles(self._ground, self._way.points, self._rng), Material.GROUND)
        return self._solids.finished(self._ground)

    def _line(self, centre: Floats, at: int, side: int, length: float) -> None:
        kind, yaw, foot = self._rng.random(), float(self._yaw[at]), self._on(centre, -0.2)
        if kind < 0.4 * self._green[at] + 0.1:
            self._solids.add(vegetation.hedge(foot, yaw, length, self._rng), Material.LEAF)
        elif kind < 0.6:
            wall = block((0, 0, 0), (length, 0.25, self._rng.uniform(0.8, 2.0)), Material.WALL)
            self._solids.blocks.append(wall.placed(foot, yaw))
        elif kind < 0.85:
            x, y, z = self._on(self._beside(at, side * max(self._clear - 1.6, 3.1)))
            self._solids.slots.append((float(x), float(y), float(z), yaw))
        elif kind < 0.93:
            pole = block((0, 0, 0), (0.18, 0.18, self._rng.uniform(4, 9)), Material.METAL)
            self._solids.blocks.append(pole.placed(foot, 0.0))

    def _free(self, centre: Floats, length: float, depth: float) -> bool:
        if self._style.touching:
            return bool(self._tree.query(centre)[0] > depth / 2 + self._clear)
        if self._tree.query(centre)[0] < self._clear + 0.4 * float(np.hypot(length, depth)):
            return False
        reach = 0.45 * max(length, depth)
        return all(np.hypot(*(centre - other)) > reach + size for other, size in self._houses)

    def _beside(self, at: int, left: float) -> Floats:
        yaw = self._yaw[at]
        return np.asarray(self._way.points[at] + left * np.array([-np.sin(yaw), np.cos(yaw)]))

    def _on(self, xy: Floats, above: float = 0.0) -> Floats:
        return np.append(xy, float(self._ground.terrain(xy)) + above)


def _meets_itself(way: Path, tree: cKDTree) -> list[bool]:
    """Where the way comes back to ground that it has passed before."""
    near = tree.query_ball_point(way.points, _SAME_WAY_M)
    return [min(points) < index - _FORGOTTEN_M for index, points in enumerate(near)]


def _house(length: float, depth: float, height: float, side: int, rng: np.random.Generator) -> Blocks:
    """A house at the origin whose front looks to the way: walls, perhaps a roof and a porch, windows."""
    front = -side * depth / 2
    parts = [block((0, 0, 0), (length, depth, height + 1), Material.WALL)]
    if rng.random() < 0.6:
        roof = (length + 0.6, depth + 0.6, rng.uniform(1.5, 4.0))
        parts.append(block((0, 0, height + 1), roof, Material.ROOF, (1.0, 0.05)))
    if rng.random() < 0.5:
        size = (rng.uniform(2, 5), rng.uniform(1.5, 3.0), height * rng.uniform(0.4, 1.0))
        parts.append(block((rng.uniform(-0.3, 0.3) * length, front - side * 1.0, 0), size, Material.WALL))
    for column in range(int(length // 3.2)):
        for storey in range(int(height // 2.9)):
            if rng.random() < 0.7:
                place = (-length / 2 + 1.6 + 3.2 * column, front, 2.0 + 2.9 * storey)
                parts.append(block(place, (rng.uniform(0.8, 1.6), 0.3, 1.3), Material.GLASS))
    return joined(parts)
