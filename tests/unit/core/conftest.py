"""Analytic scenes: rays against planes, spheres and boxes, so that every surface is known in closed form."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from revisit.core.config import SubmapConfig
from revisit.core.geometry import se3
from revisit.core.scan import Scan
from revisit.core.submap import Submap

Shape = Callable[[np.ndarray, np.ndarray], np.ndarray]


def ground(height: float = 0.0) -> Shape:
    """The plane z = height."""

    def ranges(origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore"):
            t = (height - origin[2]) / directions[:, 2]
        return np.where(t > 0, t, np.inf)

    return ranges


def sphere(centre: tuple[float, float, float], radius: float) -> Shape:
    """A ball."""

    def ranges(origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        to_centre = np.asarray(centre) - origin
        along = directions @ to_centre
        discriminant = along**2 - to_centre @ to_centre + radius**2
        t = along - np.sqrt(np.maximum(discriminant, 0))
        return np.where((discriminant > 0) & (t > 0), t, np.inf)

    return ranges


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Shape:
    """An axis-aligned box."""

    def ranges(origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (np.asarray(low) - origin) / directions, (np.asarray(high) - origin) / directions
        enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
        return np.where((enter < leave) & (enter > 0), enter, np.inf)

    return ranges


def sweep(shapes: list[Shape], origin: np.ndarray, beams: int = 48, columns: int = 720) -> np.ndarray:
    """The returns (n, 3) in the world of a spinning sensor at `origin` with beams from -25 to +15 degrees."""
    azimuth = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    elevation = np.radians(np.linspace(-25, 15, beams))
    a, e = (grid.ravel() for grid in np.meshgrid(azimuth, elevation))
    directions = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    t = np.min([shape(origin, directions) for shape in shapes], axis=0)
    hit = t < 60.0
    return origin + t[hit, None] * directions[hit]


def drive(scene: Callable[[int], list[Shape]], scans: int = 7, step: float = 1.5, beams: int = 48) -> Submap:
    """A submap of a drive along x at 1.7 m height; `scene(i)` are the shapes at scan i. Its frame is the world's,
    moved to the middle scan."""
    taken = []
    for i in range(scans):
        origin = np.array([(i - scans // 2) * step, 0.0, 1.7])
        points = sweep(scene(i), origin, beams) - origin
        taken.append(Scan.validated(points, se3.from_rotation_translation(np.eye(3), origin), i * 100_000_000))
    return Submap.from_scans(taken, SubmapConfig())


@pytest.fixture
def shapes() -> dict[str, Callable[..., Shape]]:
    """Constructors of the analytic shapes."""
    return {"ground": ground, "sphere": sphere, "box": box}


@pytest.fixture
def make_drive() -> Callable[..., Submap]:
    """Builds a submap from a scene."""
    return drive
