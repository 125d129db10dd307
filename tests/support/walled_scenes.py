"""Submaps known point by point: a floor, houses, and walls that stand before them on some days."""

from __future__ import annotations

import numpy as np

from revisit.core.config import ImplicitMapConfig
from revisit.core.geometry import se3
from revisit.core.implicit_map import NeuralMap
from revisit.core.implicit_map.neural_points import NeuralPoints
from revisit.core.merge.fused import PlacedMap
from revisit.core.merge.overlap import points_in_map

STEP = 0.3
DAY_NS = 86_400 * 10**9
EPOCH_NS = 1_700_000_000 * 10**9
WALL, FARTHER = (0.0, 8.0), (5.0, 8.0)
"""Middles of the wall, 3 m long and 2 m high, where it may stand: sixteen metres before the houses."""


def wall_at(middle):
    x, z = np.meshgrid(np.arange(-1.5, 1.5, STEP), np.arange(0.15, 2.0, STEP))
    return np.column_stack([middle[0] + x.ravel(), np.full(x.size, middle[1]), z.ravel() - 1.7])


def seen(session, *walls, day=None, x_m=0.0, behind=True):
    """A submap at (x_m, 0), 1.7 m above a floor; houses stand along y = 16, and walls at their middles before them."""
    steps = np.arange(-22.0, 22.0, STEP)
    floor = np.column_stack([grid.ravel() for grid in np.meshgrid(steps, steps)] + [np.full(len(steps) ** 2, -1.7)])
    floor = floor[(floor[:, 1] < 16.0) & (np.hypot(floor[:, 0], floor[:, 1]) < 22.0)]
    along, up = np.meshgrid(np.arange(-20.0, 20.0, STEP), np.arange(-1.6, 3.0, STEP))
    houses = np.column_stack([along.ravel(), np.full(along.size, 16.0), up.ravel()])
    parts = [floor, *([houses] if behind else []), *(wall_at((one[0] - x_m, one[1])) for one in walls)]
    points = np.concatenate(parts).astype(np.float32)
    normals = np.tile(np.float32([0.0, 0.0, 1.0]), (len(points), 1))
    known = NeuralPoints.remembered(points, normals, np.full(len(points), 3, np.int32), 3)
    neural_map = NeuralMap.of_planes(known, np.arange(3), ImplicitMapConfig())
    stamp_ns = EPOCH_NS + (session if day is None else day) * DAY_NS
    return PlacedMap(neural_map, se3.from_yaw(0.0, (x_m, 0.0, 0.0)), session, stamp_ns)


def of_wall(one, middle=WALL):
    """Which of the points of a map are of the wall at a place."""
    points = points_in_map(one)
    return (np.abs(points[:, 0] - middle[0]) < 1.6) & (np.abs(points[:, 1] - middle[1]) < 0.1) & (points[:, 2] > -1.65)
