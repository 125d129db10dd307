"""Houses of a few repeated styles, built of blocks: piers and bands leave recessed windows, balconies stick out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from revisit.evaluation.simulator.blocks import Blocks, Material, block, joined

FOUNDATION_M = 1.5


@dataclass(frozen=True)
class Facade:
    """How the houses of a style look. Lengths in metres."""

    floor_height: float
    bay: float
    window_share: float
    recess: float
    balcony_depth: float
    roof: str
    floors: tuple[int, int]
    width: tuple[float, float]
    depth: tuple[float, float]
    setback: tuple[float, float]


STYLES: tuple[Facade, ...] = (
    Facade(2.9, 2.6, 0.45, 0.18, 0.0, "gable", (2, 2), (9.0, 13.0), (8.0, 10.0), (3.0, 7.0)),
    Facade(3.0, 3.2, 0.55, 0.25, 1.3, "flat", (3, 5), (16.0, 26.0), (11.0, 13.0), (2.0, 5.0)),
    Facade(3.6, 4.0, 0.70, 0.35, 0.0, "flat", (2, 4), (14.0, 22.0), (12.0, 16.0), (0.3, 1.5)),
    Facade(2.8, 2.2, 0.40, 0.15, 0.0, "hip", (1, 2), (10.0, 14.0), (9.0, 12.0), (5.0, 10.0)),
    Facade(3.1, 2.4, 0.50, 0.20, 0.9, "gable", (3, 4), (7.0, 9.0), (10.0, 12.0), (0.5, 1.5)),
)


def build_house(style: Facade, width: float, depth: float, rng: np.random.Generator) -> Blocks:
    """A house in its own frame: x along the street, the street front at y = 0, the house at y > 0, ground at z = 0."""
    floors = int(rng.integers(style.floors[0], style.floors[1] + 1))
    height = floors * style.floor_height
    size = (width, depth - 2 * style.recess, height + FOUNDATION_M)
    core = block((0, depth / 2, -FOUNDATION_M), size, Material.GLASS)
    parts = [core, *_front(style, width, depth, floors, 0.0), *_front(style, width, depth, floors, depth)]
    parts += _flanks(style, width, depth, floors)
    parts += _roof(style, width, depth, height, rng)
    if style.balcony_depth > 0:
        parts += _balconies(style, width, floors, rng)
    parts += _annexes(width, depth, rng)
    return joined(parts)


def _front(style: Facade, width: float, depth: float, floors: int, y: float) -> list[Blocks]:
    """Piers and bands of the wall at `y`: between them is a window, `recess` metres deeper."""
    bays = max(1, round(width / style.bay))
    pitch = width / bays
    pier = pitch * (1.0 - style.window_share)
    y_centre = y + np.sign(depth / 2 - y) * style.recess / 2
    height = floors * style.floor_height
    edges = np.linspace(-width / 2, width / 2, bays + 1)
    piers = [
        block((np.clip(x, -width / 2 + pier / 4, width / 2 - pier / 4), y_centre, -FOUNDATION_M),
              (pier if 0 < i < bays else pier / 2, style.recess, height + FOUNDATION_M), Material.WALL)
        for i, x in enumerate(edges)
    ]  # fmt: skip
    sill = 0.5 * style.floor_height
    bands = [
        block((0, y_centre, floor * style.floor_height - (0.3 if floor else FOUNDATION_M)),
              (width, style.recess, sill - 0.25 + (0.0 if floor else FOUNDATION_M)), Material.WALL)
        for floor in range(floors)
    ]  # fmt: skip
    return [*piers, *bands, block((0, y_centre, height - 0.5), (width, style.recess, 0.5), Material.WALL)]


def _flanks(style: Facade, width: float, depth: float, floors: int) -> list[Blocks]:
    height = floors * style.floor_height + FOUNDATION_M
    size = (0.12, depth, height)
    walls = [block((side * (width / 2 + 0.06), depth / 2, -FOUNDATION_M), size, Material.WALL) for side in (-1, 1)]
    chimney = block((width / 2 + 0.3, depth * 0.6, -FOUNDATION_M), (0.5, 0.9, height + 2.0), Material.WALL)
    return [*walls, chimney] if style.roof != "flat" else walls


def _roof(style: Facade, width: float, depth: float, height: float, rng: np.random.Generator) -> list[Blocks]:
    if style.roof == "flat":
        parapet = block((0, depth / 2, height), (width + 0.3, depth + 0.3, 0.6), Material.ROOF)
        box = block((rng.uniform(-0.3, 0.3) * width, depth * 0.5, height + 0.6), (3.0, 3.5, 2.2), Material.WALL)
        return [parapet, box]
    rise = rng.uniform(0.3, 0.5) * depth
    top = (1.0, 0.02) if style.roof == "gable" else (0.5, 0.02)
    roof = block((0, depth / 2, height), (width + 0.8, depth + 0.9, rise), Material.ROOF, top)
    dormers = [
        block((x, depth * 0.22, height + 0.2), (1.6, 2.2, min(1.7, rise * 0.7)), Material.WALL)
        for x in (-width / 4, width / 4)
        if style.roof == "gable" and rng.random() < 0.5
    ]
    return [roof, *dormers]


def _balconies(style: Facade, width: float, floors: int, rng: np.random.Generator) -> list[Blocks]:
    bays = max(1, round(width / style.bay))
    xs = (np.arange(bays) + 0.5) * width / bays - width / 2
    chosen = xs[rng.random(bays) < 0.5]
    parts = []
    for x in chosen:
        for floor in range(1, floors):
            z, d = floor * style.floor_height, style.balcony_depth
            parts.append(block((x, -d / 2, z - 0.2), (style.bay * 0.8, d, 0.2), Material.WALL))
            parts.append(block((x, -d + 0.04, z), (style.bay * 0.8, 0.08, 1.0), Material.METAL))
    return parts


def _annexes(width: float, depth: float, rng: np.random.Generator) -> list[Blocks]:
    """Porch steps in front and, now and then, a shed behind."""
    porch = block((rng.uniform(-0.3, 0.3) * width, -0.6, -FOUNDATION_M), (1.8, 1.2, FOUNDATION_M + 0.45), Material.WALL)
    canopy = block((porch.base[0, 0], -0.5, 2.3), (1.8, 1.0, 0.15), Material.ROOF)
    shed_at = (rng.uniform(-0.4, 0.4) * width, depth + rng.uniform(2.0, 5.0), -FOUNDATION_M)
    shed_size = (rng.uniform(2.5, 5), rng.uniform(2.0, 3.0), FOUNDATION_M + rng.uniform(2.0, 2.8))
    shed = block(shed_at, shed_size, Material.WALL)
    return [porch, canopy, shed] if rng.random() < 0.5 else [porch, canopy]
