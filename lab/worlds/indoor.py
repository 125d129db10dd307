"""Halls that repeat, to be driven: a garage, a warehouse, an office; each with what lasts and what another day changes.

Seeds 800 to 899 are for these worlds only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lab.worlds.open_world import OpenSolids, OpenWorld
from revisit.evaluation.simulator.blocks import Blocks, Floats, Material, block
from revisit.evaluation.simulator.paths import Path


@dataclass(frozen=True)
class Floor:
    """Level ground."""

    def terrain(self, xy: Floats) -> Floats:
        """See Terrain."""
        return np.zeros(np.shape(xy)[:-1])


@dataclass(frozen=True)
class Hall:
    """A hall as it was when it was mapped and on a later day, the way of the mapping and ways through it later."""

    name: str
    mapped: OpenWorld
    later: OpenWorld
    map_way: Path
    ways: tuple[Path, ...]


Add = Callable[[Blocks], None]


def _room(add: Add, length: float, width: float, height: float) -> None:
    """Floor, ceiling and four walls of a hall from the origin on."""
    middle = (length / 2, width / 2)
    add(block((*middle, -0.3), (length + 1, width + 1, 0.3), Material.GROUND))
    add(block((*middle, height), (length + 1, width + 1, 0.3), Material.WALL))
    for y in (0.0, width):
        add(block((length / 2, y, 0.0), (length, 0.2, height), Material.WALL))
    for x in (0.0, length):
        add(block((x, width / 2, 0.0), (0.2, width, height), Material.WALL))


def _world(parts: list[Blocks]) -> OpenWorld:
    return OpenSolids(parts).finished(Floor())


def garage(seed: int) -> Hall:
    """Two aisles with pillars every 8 m and bays on either side; half of the cars differ from day to day."""
    return Hall(
        "garage",
        _garage(seed, 0),
        _garage(seed, 1),
        Path.through([[6.0, 12.0], [90.0, 12.0], [90.0, 36.0], [6.0, 36.0], [6.0, 14.0]]).rounded(4.0),
        (
            Path.through([[90.0, 34.0], [90.0, 12.5], [6.0, 12.5], [6.0, 36.0], [88.0, 36.0]]).rounded(4.0),
            Path.through([[6.0, 12.5], [6.0, 36.5], [90.0, 36.5], [90.0, 12.0], [10.0, 12.0]]).rounded(4.0),
        ),
    )


def _garage(seed: int, day: int) -> OpenWorld:
    lasting, passing = np.random.default_rng([seed, 1]), np.random.default_rng([seed, 2, day])
    parts: list[Blocks] = []
    _room(parts.append, 96.0, 48.0, 2.8)
    for x in np.arange(8.0, 96.0, 8.0):
        for y in (6.0, 18.0, 30.0, 42.0):
            parts.append(block((x, y, 0.0), (0.5, 0.5, 2.8), Material.WALL))
            if lasting.random() < 0.06:
                parts.append(block((x + 0.4, y, 0.8), (0.35, 0.7, 1.0), Material.METAL))
        parts.append(block((x, 24.0, 2.3), (0.4, 48.0, 0.5), Material.WALL))
    stairs = lasting.uniform(30.0, 60.0)
    parts.append(block((stairs, 24.0, 0.0), (6.0, 6.0, 2.8), Material.WALL))
    parts.append(block((lasting.uniform(6.0, 20.0), 45.5, 0.0), (5.0, 5.0, 2.8), Material.WALL))
    parts.append(block((94.0, lasting.uniform(20.0, 28.0), 0.0), (4.0, 7.0, 1.4), Material.WALL, (1.0, 0.05)))
    for row in (3.0, 21.0, 27.0, 45.0):
        for x in np.arange(12.0, 88.0, 2.65):
            if abs(x - stairs) < 5.0 and 18.0 < row < 30.0:
                continue
            stays = lasting.random() < 0.3
            if stays or passing.random() < 0.4:
                rng = lasting if stays else passing
                size = (rng.uniform(1.65, 1.95), rng.uniform(3.8, 4.9), rng.uniform(1.35, 1.9))
                parts.append(block((x, row, 0.2), size, Material.METAL, (0.85, 0.6)))
    return _world(parts)


def warehouse(seed: int) -> Hall:
    """Ten aisles of racks 40 m long; the last three were not mapped, a part of the goods differs from day to day."""
    pitch, first, last = 5.4, 5.0, 45.0
    serpentine = [
        point
        for n in range(7)
        for point in ([(first, 3 + n * pitch), (last, 3 + n * pitch)][:: 1 if n % 2 == 0 else -1])
    ]
    return Hall(
        "warehouse",
        _warehouse(seed, 0),
        _warehouse(seed, 1),
        Path.through(serpentine).rounded(2.0),
        (
            _aisles(pitch, [(last, 2), (first, 2), (first, 5), (last, 5), (last, 1), (12.0, 1)]),
            _aisles(pitch, [(first, 6), (last, 6), (last, 9), (first, 9), (first, 4), (last, 4)]),
        ),
    )


def _aisles(pitch: float, points: list[tuple[float, int]]) -> Path:
    """The way through points: x, and the number of the aisle."""
    return Path.through([[x, 3.0 + pitch * aisle] for x, aisle in points]).rounded(2.0)


def _warehouse(seed: int, day: int) -> OpenWorld:
    lasting, passing = np.random.default_rng([seed, 1]), np.random.default_rng([seed, 2, day])
    parts: list[Blocks] = []
    _room(parts.append, 50.0, 57.0, 8.0)
    for dock in lasting.uniform(3.0, 54.0, 4):
        parts.append(block((0.3, dock, 0.0), (0.6, 3.2, 3.4), Material.METAL))
    for office in lasting.uniform(5.0, 50.0, 2):
        parts.append(block((48.5, office, 0.0), (2.6, lasting.uniform(2.0, 4.0), 3.0), Material.WALL))
    for rack in range(11):
        y = 0.3 + 5.4 * rack
        for x in np.arange(8.0, 42.0, 2.7):
            for dy in (-0.5, 0.5):
                parts.append(block((x, y + dy, 0.0), (0.12, 0.12, 6.5), Material.METAL))
            for level in (0.15, 2.2, 4.2):
                parts.append(block((x + 1.35, y, level), (2.7, 1.1, 0.12), Material.METAL))
                for slot in (0.7, 2.0):
                    stays = lasting.random() < 0.6
                    rng = lasting if stays else passing
                    if rng.random() < 0.85:
                        size = (rng.uniform(0.9, 1.25), rng.uniform(0.8, 1.0), rng.uniform(0.8, 1.7))
                        parts.append(block((x + slot, y, level + 0.12), size, Material.CLOTH))
    return _world(parts)


def office(seed: int) -> Hall:
    """A ring of corridors with equal rooms on either side; doors are open or not, furniture moves."""
    return Hall(
        "office",
        _office(seed, 0),
        _office(seed, 1),
        Path.through([[1.2, 7.0], [38.8, 7.0], [38.8, 21.0], [1.2, 21.0], [1.2, 8.0]]).rounded(0.8),
        (
            Path.through([[36.0, 21.2], [1.1, 21.2], [1.1, 7.2], [38.0, 7.2]]).rounded(0.8),
            Path.through([[4.0, 6.8], [38.9, 6.8], [38.9, 21.0], [6.0, 21.0]]).rounded(0.8),
        ),
    )


def _office(seed: int, day: int) -> OpenWorld:
    lasting, passing = np.random.default_rng([seed, 1]), np.random.default_rng([seed, 2, day])
    parts: list[Blocks] = []
    _room(parts.append, 40.0, 28.0, 2.7)
    for side, (wall, back) in enumerate(((6.0, 0.0), (8.0, 14.0), (20.0, 14.0), (22.0, 28.0))):
        towards = np.sign(back - wall)
        inner = side in (1, 2)
        for x in np.arange(2.4 if inner else 0.0, 37.0 if inner else 39.0, 4.0):
            open_ = (lasting if lasting.random() < 0.6 else passing).random() < 0.4
            parts.append(block((x, (wall + back) / 2, 0.0), (0.12, abs(back - wall), 2.7), Material.WALL))
            parts.append(block((x + 1.5, wall, 0.0), (3.0, 0.12, 2.7), Material.WALL))
            parts.append(block((x + 3.5, wall, 2.1), (1.0, 0.12, 0.6), Material.WALL))
            if not open_:
                parts.append(block((x + 3.5, wall, 0.0), (1.0, 0.06, 2.1), Material.WALL))
            for _ in range(3):
                rng = lasting if lasting.random() < 0.6 else passing
                at = x + rng.uniform(0.8, 3.2), wall + towards * rng.uniform(1.2, 5.0)
                parts.append(block((*at, 0.0), (rng.uniform(0.5, 1.6), rng.uniform(0.5, 0.9), rng.uniform(0.6, 1.9)),
                                   Material.CLOTH))  # fmt: skip
            if lasting.random() < 0.15:
                parts.append(block((x + 1.2, wall - towards * 0.3, 0.0), (0.9, 0.45, 1.6), Material.METAL))
    for x in (2.4, 37.6):
        parts.append(block((x, 14.0, 0.0), (0.12, 12.0, 2.7), Material.WALL))
    if lasting.random() < 1.0:
        parts.append(block((39.6, lasting.uniform(10, 18), 0.0), (0.5, 2.0, 2.2), Material.METAL))
        parts.append(block((0.3, lasting.uniform(10, 18), 0.0), (0.4, 1.2, 1.9), Material.CLOTH))
    return _world(parts)


HALLS = {"garage": garage, "warehouse": warehouse, "office": office}
