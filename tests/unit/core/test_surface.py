"""Marching cubes, ground removal and clustering (paper III-C)."""

from __future__ import annotations

from collections import Counter

import numpy as np

from revisit.core.clusters import euclidean_clusters, find_ground, segment_clusters
from revisit.core.config import ClusterConfig, ImplicitMapConfig, SurfaceConfig
from revisit.core.kernels.marching_cubes import polygonise
from revisit.core.surface import Surface, surface_from_points
from revisit.core.surface.marching_cubes import CORNERS, case_table, edge_table


def cells_of_a_box(size: int) -> tuple[np.ndarray, np.ndarray]:
    """All cells (m, 8) of a cube of `size` corners an edge and its corners (n, 3)."""
    corners = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    lower = corners[(corners < size - 1).all(axis=1)]
    rows = lower[:, None] + CORNERS
    return ((rows[..., 0] * size + rows[..., 1]) * size + rows[..., 2]).astype(np.int32), corners.astype(np.float32)


def test_the_mesh_of_a_ball_is_closed_and_faces_outward():
    cells, corners = cells_of_a_box(16)
    centre = np.array([7.3, 7.6, 7.4])
    values = (np.linalg.norm(corners - centre, axis=1) - 5.2).astype(np.float32)
    vertices, faces, _ = polygonise(cells, corners, values, case_table(), edge_table(), 1.0)
    edges = Counter(tuple(sorted((int(f[k]), int(f[(k + 1) % 3])))) for f in faces for k in range(3))
    assert set(edges.values()) == {2}
    assert len(vertices) - len(edges) + len(faces) == 2
    triangles = vertices[faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    assert (np.sum(normals * (triangles.mean(axis=1) - centre), axis=1) > 0).all()
    assert np.abs(np.linalg.norm(vertices - centre, axis=1) - 5.2).max() < 0.05


def test_random_fields_give_meshes_without_holes():
    cells, corners = cells_of_a_box(9)
    values = np.random.default_rng(0).normal(size=len(corners)).astype(np.float32)
    inner = ((corners > 0) & (corners < 8)).all(axis=1)
    values[~inner] = 1.0
    _, faces, _ = polygonise(cells, corners, values, case_table(), edge_table(), 1.0)
    directed = Counter((int(f[k]), int(f[(k + 1) % 3])) for f in faces for k in range(3))
    assert len(faces) > 500
    assert all(directed[(b, a)] == count for (a, b), count in directed.items())


def test_no_surface_is_made_where_a_corner_was_not_observed():
    cells, corners = cells_of_a_box(8)
    values = (corners[:, 2] - 3.5).astype(np.float32)
    values[corners[:, 0] > 4] = np.nan
    vertices, _, crossing = polygonise(cells, corners, values, case_table(), edge_table(), 1.0)
    assert vertices[:, 0].max() == 4.0
    assert crossing.sum() == 4 * 7


def test_the_case_table_has_the_820_triangles_of_the_classic_algorithm():
    assert (case_table()[:, :, 0] >= 0).sum() == 820
    assert (case_table()[0] == -1).all() and (case_table()[255] == -1).all()


def test_clusters_agree_with_connected_components_by_brute_force():
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 12, (600, 3)).astype(np.float32)
    labels = euclidean_clusters(points, 0.9)
    near = ((points[:, None] - points) ** 2).sum(axis=2) < 0.9**2
    reached = np.linalg.matrix_power(near.astype(float), 1) > 0
    for _ in range(10):
        reached = (reached.astype(np.float32) @ reached.astype(np.float32)) > 0
    assert labels.max() > 5
    assert np.array_equal(labels[:, None] == labels, reached)


def surface_of(vertices: np.ndarray, normals: np.ndarray) -> Surface:
    return Surface(
        vertices.astype(np.float32), normals.astype(np.float32), np.zeros((0, 3), np.int32),
        np.zeros((0, 3), np.int32), np.zeros(0, np.float32), 0.4,
    )  # fmt: skip


def test_ground_does_not_join_two_buildings_and_the_larger_one_comes_first():
    grid = np.stack(np.meshgrid(np.arange(0, 20, 0.4), np.arange(0, 20, 0.4)), axis=-1).reshape(-1, 2)
    road = np.c_[grid, np.zeros(len(grid))]
    heights = np.arange(0.0, 4.0, 0.4)
    walls = [
        np.array([[x, y, z] for y in np.arange(0, length, 0.4) for z in heights]) for x, length in ((5, 8), (15, 16))
    ]
    vertices = np.concatenate([road, *walls])
    normals = np.concatenate([np.tile([0, 0, 1.0], (len(road), 1)), np.tile([1.0, 0, 0], (sum(map(len, walls)), 1))])
    clusters = segment_clusters(surface_of(vertices, normals), ClusterConfig())
    assert clusters.count == 2
    assert (clusters.labels[: len(road)] == -1).all()
    assert (clusters.labels[len(road) : len(road) + len(walls[0])] == 1).all()
    assert (clusters.labels[-len(walls[1]) :] == 0).all()


def test_a_flat_roof_is_not_ground():
    road = np.array([[x, y, 0.0] for x in np.arange(0, 8, 0.4) for y in np.arange(0, 8, 0.4)])
    vertices = np.concatenate([road, road + [0, 0, 6.0]])
    clusters = segment_clusters(surface_of(vertices, np.tile([0, 0, 1.0], (len(vertices), 1))), ClusterConfig())
    assert clusters.ground[: len(road)].all() and not clusters.ground[len(road) :].any()


def test_the_far_ring_of_one_beam_is_ground_whatever_its_normal():
    road = np.array([[x, y, 0.0] for x in np.arange(-8, 8, 0.4) for y in np.arange(-8, 8, 0.4)])
    angle = np.linspace(0, 2 * np.pi, 600)
    ring = np.c_[30 * np.cos(angle), 30 * np.sin(angle), np.random.default_rng(0).uniform(-0.2, 0.3, 600)]
    wall = np.array([[31.0, y, z] for y in np.arange(0, 6, 0.4) for z in np.arange(0.0, 3.0, 0.4)])
    vertices = np.concatenate([road, ring, wall])
    normals = np.concatenate([np.tile([0, 0, 1.0], (len(road), 1)), np.tile([0.6, 0, 0.8], (600 + len(wall), 1))])
    ground = find_ground(surface_of(vertices, normals), ClusterConfig())
    away = np.abs(ring[:, 1] - 3) > 6
    assert ground[: len(road)].all()
    assert ground[len(road) : len(road) + 600][away].all()
    assert not ground[-len(wall) :].any()


def test_without_the_implicit_map_the_surface_is_voxel_counts_and_pca_normals(make_drive, shapes):
    submap = make_drive(lambda _: [shapes["ground"](), shapes["box"]((10, -6, 0), (12, 6, 5))])
    surface = surface_from_points(submap, ImplicitMapConfig(), SurfaceConfig())
    near = np.linalg.norm(surface.vertices[:, :2], axis=1) < 8
    assert surface.occupancy.min() >= SurfaceConfig().min_returns
    assert np.median(surface.normals[near, 2]) > 0.99
