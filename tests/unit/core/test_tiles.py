"""Tiles of a map: which there are, and that their surfaces meet and are those of the submaps they are made of."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.config import ImplicitMapConfig
from revisit.core.geometry import se3
from revisit.core.geometry.tile_grid import TileGrid
from revisit.core.implicit_map import NeuralMap
from revisit.core.implicit_map.neural_points import NeuralPoints
from revisit.core.merge.fused import PlacedMap
from revisit.core.merge.tiles import distances_m, fuse_tile
from revisit.core.model_bundle import load_packaged_models

GRID = TileGrid.of(0.4, 1.0)
SLOPE = 0.1
"""A floor that rises along x, from -40 to 40 m in both directions."""


@pytest.fixture(scope="module")
def floors():
    """Two submaps that see one sloping floor from frames of their own."""
    return [floor(se3.from_yaw(0.0, (0.0, 0.0, 0.0))), floor(se3.from_yaw(0.7, (12.0, 5.0, 1.2)))]


def floor(T_map_submap):
    """The floor as neural points in the frame of the submap, which sees 40 m around itself."""
    config = ImplicitMapConfig()
    steps = np.arange(-40.0, 40.0, config.resolution) + 0.21
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    position = T_map_submap[:3, 3]
    world = np.column_stack([x + position[0], y + position[1], SLOPE * (x + position[0])])
    up = np.tile([-SLOPE, 0.0, 1.0] / np.hypot(SLOPE, 1.0), (len(world), 1))
    T = se3.inverse(T_map_submap)
    points = se3.apply(T, world).astype(np.float32), (up @ T[:3, :3].T).astype(np.float32)
    seen = NeuralPoints.remembered(*points, np.full(len(world), 3, np.int32), 3)
    return PlacedMap(NeuralMap.of_planes(seen, np.arange(3), config), T_map_submap)


def test_tiles_are_those_within_reach_and_each_names_its_submaps():
    positions = np.array([[1.0, 1.0, 0.0], [200.0, 1.0, 3.0]])
    reached = GRID.reached(positions, 10.0)
    assert {cell: rows.tolist() for cell, rows in reached.items()} == {
        (-1, -1): [0], (-1, 0): [0], (0, -1): [0], (0, 0): [0], (3, -1): [1], (3, 0): [1], (4, -1): [1], (4, 0): [1],
    }  # fmt: skip
    for cell, rows in GRID.reached(np.random.default_rng(0).uniform(-300, 300, (40, 3)), 60.0).items():
        lower, upper = GRID.bounds(cell)
        assert np.allclose(GRID.centre(cell)[:2], np.add(lower, upper) / 2) and len(rows)
    assert GRID.cells(np.array([[-0.01, 51.3, 9.0]])) == [(-1, 1)]


def test_the_surfaces_of_neighbours_meet_without_gap_or_overlap(floors):
    cells = [(column, row) for column in (-1, 0) for row in (-1, 0)]
    area = 0.0
    for cell in cells:
        tile = fuse_tile(floors, GRID.centre(cell))
        world = tile.mesh.vertices.astype(np.float64) + GRID.centre(cell)
        np.testing.assert_allclose(world[:, 2], SLOPE * world[:, 0], atol=0.02)
        assert np.all(tile.mesh.normals[:, 2] > 0.9)
        corners = world[tile.mesh.faces]
        seen_from_above = 0.5 * np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2])
        area += seen_from_above[np.abs(corners.mean(axis=1)[:, :2]).max(axis=1) < 25.6].sum()
    assert area == pytest.approx(51.2**2, rel=0.01)


def test_distances_are_those_to_the_surface_in_the_frame_of_the_map(floors):
    tile = fuse_tile(floors, GRID.centre((0, 0)))
    neural_map = NeuralMap.from_blob(tile.neural_map, load_packaged_models().decoder, ImplicitMapConfig())
    points = np.array([[10.0, 10.0, 1.3], [10.0, 10.0, 0.8], [20.0, 3.0, 30.0]])
    distance, nearest = distances_m(neural_map, points)
    upright = 1.0 / np.hypot(SLOPE, 1.0)
    np.testing.assert_allclose(distance[:2], [0.3 * upright, -0.2 * upright], atol=0.02)
    assert nearest[0] < 0.6 and np.isinf(nearest[2])


def test_a_tile_that_nothing_reaches_is_none_and_order_plays_no_part(floors):
    assert fuse_tile(floors, GRID.centre((40, 0))) is None
    first, second = (fuse_tile(order, GRID.centre((0, 0))) for order in (floors, floors[::-1]))
    assert len(first.points.vertices) == pytest.approx(len(second.points.vertices), rel=0.01)
    np.testing.assert_allclose(first.mesh.vertices[:, 2].mean(), second.mesh.vertices[:, 2].mean(), atol=1e-3)
