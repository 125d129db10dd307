"""Compiled kernels against the plain formulas they speed up, on small random inputs."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.clusters import Clusters
from revisit.core.config import MicroConfig
from revisit.core.geometry import se3
from revisit.core.implicit_map.decoder import encode_positions, orientations
from revisit.core.implicit_map.visibility import count_seen_through
from revisit.core.kernels.arcs import arc_tangent, arc_tangent_32
from revisit.core.kernels.choose_returns import choose_returns
from revisit.core.kernels.cluster_joins import connected_parts
from revisit.core.kernels.column_histograms import MIN_MEMBERS, column_histograms
from revisit.core.kernels.elastic_points import POOLED_RETURNS, RECORD, insert_returns, pooled_covariances
from revisit.core.kernels.filter_layers import add_amplitudes, multiply_spectrum, strongest_layer
from revisit.core.kernels.heading_profiles import face_profiles, plan_profiles
from revisit.core.kernels.nearest_points import any_within, nearest_points
from revisit.core.kernels.neighbour_blend import blend_neighbours, blend_normals, tangent_frames
from revisit.core.kernels.oriented_normals import NORMAL_PRIOR, oriented_normals
from revisit.core.kernels.patch_histograms import disc_histograms, patch_histograms
from revisit.core.kernels.plane_votes import plane_scores
from revisit.core.kernels.point_columns import MAX_GRID, columns_of
from revisit.core.kernels.rigid_motion import moved_points, place_returns
from revisit.core.kernels.settled_planes import spots_on_planes
from revisit.core.kernels.visibility import range_image
from revisit.core.kernels.voxel_table import VoxelTable, empty_slots, table_of, voxels_of
from revisit.core.micro.cluster_normals import (
    aligned_to_unit_sphere,
    angular_histogram,
    describe_clusters,
    histogram_size,
    pair_classes,
    regional_means,
)
from revisit.core.micro.saliency import weigh_clusters
from revisit.core.sanity.ground import scores_of_planes
from revisit.core.surface import Surface


def unit_rows(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def plain_column_histogram(
    vertices: np.ndarray, normals: np.ndarray, keypoint: np.ndarray, config: MicroConfig
) -> np.ndarray:
    """psi of one column by the numpy functions of `micro.cluster_normals`."""
    inside = np.hypot(*(vertices[:, :2] - keypoint).T) < config.radius
    if inside.sum() < MIN_MEMBERS:
        return np.zeros(histogram_size(config))
    centred = vertices[inside] - [*keypoint, vertices[inside, 2].mean()]
    x, y = centred[:, 0], centred[:, 1]
    axis = 0.5 * np.arctan2(2.0 * (x * y).sum(), (x * x).sum() - (y * y).sum())
    cosine, sine = np.cos(axis), np.sin(axis)
    turn = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    means, places = regional_means(centred @ turn.T, normals[inside])
    if len(means) < 2:
        return np.zeros(histogram_size(config))
    pairs = np.stack(np.triu_indices(len(means), 1), axis=1)
    classes = pair_classes(places, pairs, config.radius, config)
    return angular_histogram(means, pairs, classes, config.distance_bins * config.height_bins)


@pytest.mark.parametrize(("distance_bins", "height_bins"), [(3, 1), (1, 1), (2, 3)])
@pytest.mark.parametrize("seed", range(4))
def test_angular_histograms_are_those_of_the_plain_functions(seed, distance_bins, height_bins):
    rng = np.random.default_rng(seed)
    config = MicroConfig(distance_bins=distance_bins, height_bins=height_bins)
    vertices, normals = rng.uniform(-15, 15, (600, 3)) * [1, 1, 0.2], unit_rows(rng, 600)
    keypoints = rng.uniform(-18, 18, (12, 2))
    bounds = np.array([0, 400, 600])
    assignment = rng.integers(0, 2, 12).astype(np.int32)
    found = column_histograms(
        vertices, normals, bounds, keypoints, assignment, config.radius, distance_bins, height_bins
    )
    for k, keypoint in enumerate(keypoints):
        rows = slice(bounds[assignment[k]], bounds[assignment[k] + 1])
        expected = plain_column_histogram(vertices[rows], normals[rows], keypoint, config)
        assert np.array_equal(found[k], expected)
    assert found.sum() > 1000


def test_the_statistics_of_clusters_are_the_histograms_of_their_columns():
    rng = np.random.default_rng(9)
    vertices, normals = rng.uniform(-9, 9, (400, 3)).astype(np.float32), unit_rows(rng, 400).astype(np.float32)
    labels = rng.integers(-1, 3, 400).astype(np.int32)
    empty = np.zeros((0, 3), np.int32)
    surface = Surface(vertices, normals, empty, empty, np.zeros(0, np.float32), 0.4)
    clusters = Clusters(labels, 3, labels < 0)
    keypoints = rng.uniform(-6, 6, (10, 2)).astype(np.float32)
    saliency = weigh_clusters(keypoints, surface, clusters, 0.5)
    found = describe_clusters(surface, clusters, keypoints, saliency, MicroConfig(), rng)
    for k in range(10):
        mine = labels == saliency.assignment[k]
        counts = plain_column_histogram(
            vertices[mine].astype(np.float64), normals[mine].astype(np.float64), keypoints[k].astype(np.float64),
            MicroConfig(),
        )  # fmt: skip
        assert np.abs(found.histograms[k] ** 2 - counts / counts.sum()).sum() < 0.02  # float32 moves a pair at most


def test_the_blend_of_neighbours_is_equations_2_to_4():
    rng = np.random.default_rng(1)
    positions, normals = rng.uniform(-1, 1, (40, 3)).astype(np.float32), unit_rows(rng, 40).astype(np.float32)
    queries = rng.uniform(-1, 1, (15, 3)).astype(np.float32)
    gaps = ((queries[:, None] - positions) ** 2).sum(axis=2)
    indices = np.argsort(gaps, axis=1)[:, :6].astype(np.int32)
    squared = np.take_along_axis(gaps, indices, axis=1)
    indices[3, 2:], squared[3, 2:] = -1, np.inf
    frames = orientations(normals)
    weights, encoding, plane = blend_neighbours(queries, positions, frames, indices, squared, 1.0, 0.4)
    inverse = np.where(indices >= 0, 1.0 / np.sqrt(squared), 0.0)
    expected = inverse / inverse.sum(axis=1, keepdims=True)
    local = np.einsum("mkab,mkb->mka", frames[indices], queries[:, None] - positions[indices])
    np.testing.assert_allclose(weights, expected, atol=1e-5)
    np.testing.assert_allclose(encoding, np.einsum("mk,mke->me", expected, encode_positions(local, 0.4)), atol=1e-4)
    np.testing.assert_allclose(plane, np.einsum("mk,mk->m", expected, local[..., 2]), atol=1e-5)
    mean = np.einsum("mk,mka->ma", expected, normals[indices])
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    np.testing.assert_allclose(blend_normals(indices, squared, normals, 1.0), mean, atol=1e-5)


def test_the_weights_of_neighbours_are_any_power_of_their_distance():
    queries, positions = np.zeros((1, 3), np.float32), np.array([[1, 0, 0], [0, 2, 0]], np.float32)
    indices, squared = np.array([[0, 1]], np.int32), np.array([[1, 4]], np.float32)
    weights, *_ = blend_neighbours(queries, positions, tangent_frames(positions), indices, squared, 2.0, 0.4)
    np.testing.assert_allclose(weights, [[0.8, 0.2]], rtol=1e-6)


def test_local_frames_are_those_of_the_plain_formula():
    normals = unit_rows(np.random.default_rng(8), 200).astype(np.float32)
    normals[:3] = [[0, 0, 1], [0, 0, -1], [5e-4, 0, 1]]
    np.testing.assert_allclose(tangent_frames(normals), orientations(normals), atol=1e-6)


def test_normals_are_the_least_axes_of_numpy_on_the_side_of_the_sensor():
    rng = np.random.default_rng(10)
    samples = rng.normal(size=(500, 8, 3)) * np.exp(2.0 * rng.normal(size=(500, 1, 3)))
    samples[:50] = 0.0
    samples[50:100, :, 1:] = 0.0
    covariances, views = np.einsum("nki,nkj->nij", samples, samples), rng.normal(size=(500, 3))
    view = views / np.linalg.norm(views, axis=1, keepdims=True)
    spread = np.trace(covariances, axis1=1, axis2=2)[:, None, None] + 1e-9
    prior = np.eye(3) - view[:, :, None] * view[:, None, :]
    expected = np.linalg.eigh(covariances / spread + NORMAL_PRIOR * prior)[1][:, :, 0]
    expected *= np.sign(np.einsum("ij,ij->i", expected, view))[:, None]
    np.testing.assert_allclose(oriented_normals(covariances, views), expected, atol=1e-6)


def test_pooled_covariances_are_those_of_the_returns_around_each_point():
    rng = np.random.default_rng(2)
    voxels = np.unique(rng.integers(-2, 2, (30, 3)), axis=0).astype(np.int32)
    clouds = [(voxel + rng.uniform(0.05, 0.95, (rng.integers(3, 20), 3))) * 0.4 for voxel in voxels]
    positions = np.array([cloud.mean(axis=0) for cloud in clouds]).astype(np.float32)
    moments = np.array([
        [len(cloud), *cloud.sum(axis=0), *(cloud.T @ cloud)[np.triu_indices(3)]] for cloud in clouds
    ])  # fmt: skip
    records = np.pad(moments, ((0, 0), (0, RECORD - moments.shape[1])))
    found = pooled_covariances(positions, records, columns_of(positions, 0.4), 0.4)
    for i, here in enumerate(positions.astype(np.float64)):
        total, samples, weights = 0.0, [], []
        for j, cloud in enumerate(clouds):
            gap = ((positions[j].astype(np.float64) - here) ** 2).sum()
            if np.abs(voxels[j] - voxels[i]).max() <= 1 and gap <= 4 * 0.4**2:
                weight = np.exp(-0.5 * gap / 0.28**2) * min(len(cloud), POOLED_RETURNS) / len(cloud)
                samples.append(cloud)
                weights.append(np.full(len(cloud), weight))
                total += weight * len(cloud)
        expected = np.cov(np.concatenate(samples).T, aweights=np.concatenate(weights), bias=True)
        np.testing.assert_allclose(found[i], expected, atol=1e-6)
        assert total > 0


def test_returns_are_chosen_in_order_and_at_most_so_many_for_each_point():
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (500, 3)).astype(np.float32)
    voxels = np.unique(voxels_of(points[:250], 0.4), axis=0)
    positions = ((voxels + 0.5) * 0.4).astype(np.float32)
    order = rng.permutation(500)
    chosen, owners = choose_returns(points, order, positions, table_of(voxels), 0.4, 2)
    row_of = {tuple(voxel): row for row, voxel in enumerate(voxels.tolist())}
    taken: dict[int, int] = {}
    expected = []
    for n in order:
        row = row_of.get(tuple(voxels_of(points[n : n + 1], 0.4)[0].tolist()))
        if row is not None and taken.get(row, 0) < 2:
            taken[row] = taken.get(row, 0) + 1
            expected.append((n, row))
    assert list(zip(chosen.tolist(), owners.tolist(), strict=True)) == expected


def test_a_range_image_holds_the_nearest_return_of_each_degree():
    rng = np.random.default_rng(4)
    points, origin = rng.uniform(-20, 20, (3000, 3)).astype(np.float32), np.array([1, 2, 0.5], np.float32)
    ray = (points - origin).astype(np.float64)
    distance = np.linalg.norm(ray, axis=1)
    column = np.floor(np.degrees(np.arctan2(ray[:, 1], ray[:, 0])) + 180.0).astype(int) % 360
    row = np.minimum(np.floor(np.degrees(np.arcsin(ray[:, 2] / distance)) + 90.0).astype(int), 179)
    expected = np.full((180, 360), np.inf)
    np.minimum.at(expected, (row, column), distance)
    found = range_image(points, origin)
    same = np.isclose(found, expected, rtol=1e-5) | (np.isinf(found) & np.isinf(expected))
    assert same.mean() > 0.9995  # a return on the border of two pixels may fall to either side


def test_a_scan_counts_only_its_own_returns_when_it_looks_through_a_point():
    wall = np.array([[10.0, y, z] for y in np.linspace(-1, 1, 41) for z in np.linspace(-1, 1, 41)], np.float32)
    points, scans = np.concatenate([wall, wall[:, [1, 0, 2]]]), np.repeat([0, 2], len(wall)).astype(np.int32)
    positions = np.array([[5.0, 0.0, 0.0], [0.0, 5.0, 0.0], [-5.0, 0.0, 0.0]], np.float32)
    assert count_seen_through(positions, points, scans, np.zeros((3, 3), np.float32)).tolist() == [1, 1, 0]


def test_an_angle_of_pi_that_was_rounded_up_counts_nothing_below_zero():
    angle = np.array([np.pi], np.float32)
    assert float(angle[0]) > np.pi
    index, weights = np.zeros((40, 40), np.int8), np.ones((40, 40), np.float32)
    counts = patch_histograms(index, weights, np.array([[20, 20]]), angle, 12, 1, 1, 6)
    assert counts.min() >= 0.0 and counts.sum() == pytest.approx(144, abs=1)


def test_patch_histograms_are_those_of_plain_loops():
    rng = np.random.default_rng(5)
    index = rng.integers(0, 6, (60, 50)).astype(np.int8)
    weights = rng.uniform(0, 1, (60, 50)).astype(np.float32) * (rng.uniform(size=(60, 50)) > 0.3)
    pixels, angles = rng.integers(5, 45, (6, 2)), rng.uniform(0, np.pi, 6).astype(np.float32)
    found = patch_histograms(index, weights.astype(np.float32), pixels, angles, 24, 2, 3, 6)
    expected = np.zeros((6, 3, 3, 6))
    for k, ((column, row), angle) in enumerate(zip(pixels, angles.astype(np.float64), strict=True)):
        for i, j in np.ndindex(12, 12):
            v, u = 2 * i + 1 - 12, 2 * j + 1 - 12
            x = round(float(column + np.cos(angle) * u - np.sin(angle) * v))
            y = round(float(row + np.sin(angle) * u + np.cos(angle) * v))
            if 0 <= y < 60 and 0 <= x < 50:
                relative = (index[y, x] - angle * 6 / np.pi) % 6
                lower, share = int(relative), relative - int(relative)
                expected[k, 2 * i * 3 // 24, 2 * j * 3 // 24, lower % 6] += weights[y, x] * (1 - share)
                expected[k, 2 * i * 3 // 24, 2 * j * 3 // 24, (lower + 1) % 6] += weights[y, x] * share
    np.testing.assert_allclose(found.reshape(expected.shape), expected, atol=1e-4)


def test_profiles_are_weighted_counts_along_each_heading():
    rng = np.random.default_rng(6)
    places, weight = rng.uniform(-20, 20, (80, 2)), rng.uniform(0, 1, 80)
    heading = rng.uniform(-np.pi, np.pi, 80)
    plan, faces = np.zeros((12, 40)), np.zeros((12, 40))
    for row in range(12):
        half, full = row * np.pi / 12, row * 2 * np.pi / 12
        column = np.floor(places @ [np.cos(half), np.sin(half)]).astype(int) + 20
        inside = (column >= 0) & (column < 40)
        np.add.at(plan[row], column[inside], weight[inside])
        column = np.floor(places @ [np.cos(full), np.sin(full)]).astype(int) + 20
        nearest = np.round(heading / (2 * np.pi / 12)).astype(int)
        away = (row - nearest + 6) % 12 - 6
        facing = np.cos(heading - full)
        inside = (column >= 0) & (column < 40) & (np.abs(away) <= 2) & (facing > 0)
        np.add.at(faces[row], column[inside], (weight * np.abs(facing) ** 4)[inside])
    np.testing.assert_allclose(plan_profiles(places, weight, 12, 40, 1.0), plan, atol=1e-9)
    np.testing.assert_allclose(face_profiles(places, heading, weight, 12, 40, 1.0, 4.0), faces, atol=1e-9)


def test_the_sphere_of_a_whole_cluster_is_aligned_as_that_of_a_column():
    rng = np.random.default_rng(7)
    points = rng.normal(size=(100, 3)) * [4, 1, 1]
    aligned, rotation = aligned_to_unit_sphere(points)
    assert np.abs(np.cov(aligned.T)[0, 1]) < 1e-12
    assert np.allclose(rotation @ rotation.T, np.eye(3))


def test_the_fast_angle_is_the_one_of_the_library():
    rng = np.random.default_rng(11)
    x, y = rng.normal(size=(2, 2000)) * np.exp(5.0 * rng.normal(size=2000))
    found = [arc_tangent(*pair) for pair in zip(y, x, strict=True)]
    np.testing.assert_allclose(found, np.arctan2(y, x), atol=3e-8)
    short = [arc_tangent_32(*pair) for pair in zip(y.astype(np.float32), x.astype(np.float32), strict=True)]
    np.testing.assert_allclose(short, np.arctan2(y, x), atol=5e-7)
    axes = [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)]
    np.testing.assert_allclose([arc_tangent(*pair) for pair in axes], [0, 0, np.pi / 2, np.pi, -np.pi / 2])


@pytest.mark.parametrize("spread", [3.0, 5000.0])
def test_queries_near_any_point_are_those_of_brute_force(spread):
    rng = np.random.default_rng(12)
    points = (rng.uniform(-spread, spread, (40, 1, 3)) + rng.uniform(-1, 1, (40, 5, 3))).reshape(-1, 3)
    points, queries = points.astype(np.float32), (points[::2] + rng.uniform(-1, 1, (100, 3))).astype(np.float32)
    gaps = np.linalg.norm(queries[:, None].astype(np.float64) - points, axis=2).min(axis=1)
    found = any_within(queries, columns_of(points, 0.6), 0.6)
    assert np.array_equal(found, gaps <= 0.6)
    assert 0 < found.sum() < len(queries)


def test_vertices_joined_by_faces_are_parts_named_by_their_first_vertex():
    faces = np.array([[5, 6, 7], [0, 2, 4], [7, 8, 9], [4, 3, 2]], np.int32)
    assert connected_parts(11, faces).tolist() == [0, 1, 0, 0, 0, 5, 5, 5, 5, 5, 10]


def test_disc_histograms_are_weighted_sums_that_end_at_the_border():
    rng = np.random.default_rng(13)
    layers, disc = rng.uniform(0, 1, (2, 20, 30)).astype(np.float32), rng.uniform(0, 1, (7, 7)).astype(np.float32)
    pixels = np.array([[15, 10], [0, 0], [29, 19], [2, 18]])
    padded = np.pad(layers, ((0, 0), (3, 3), (3, 3)))
    expected = [[(disc * layer[y : y + 7, x : x + 7]).sum() for layer in padded] for x, y in pixels]
    np.testing.assert_allclose(disc_histograms(layers, pixels, disc), expected, rtol=1e-5)


def test_returns_are_placed_as_by_the_plain_transform_without_those_out_of_range():
    rng = np.random.default_rng(14)
    points = rng.uniform(-20, 20, (500, 3)).astype(np.float32)
    pose = se3.from_yaw(0.7, (3.0, -2.0, 1.0))
    expected = se3.apply(pose, points.astype(np.float64))
    np.testing.assert_allclose(moved_points(pose, points), expected, atol=1e-5)
    ranges, placed = np.linalg.norm(points, axis=1), np.linalg.norm(expected, axis=1)
    kept = (ranges >= 8.0) & (ranges <= 25.0) & (placed <= 20.0)
    assert 50 < kept.sum() < 450
    room = np.zeros((600, 3), np.float32)
    assert place_returns(pose, points, 8.0, 25.0, 20.0, room[50:]) == kept.sum()
    np.testing.assert_allclose(room[50 : 50 + kept.sum()], expected[kept], atol=1e-5)
    assert not room[:50].any()
    rows, again = np.arange(500, dtype=np.int32), np.zeros((600, 3), np.float32)
    assert place_returns(pose, points, 8.0, 25.0, 20.0, again[50:], rows) == kept.sum()
    np.testing.assert_array_equal(rows[: kept.sum()], np.flatnonzero(kept))
    np.testing.assert_array_equal(again[50 : 50 + kept.sum()], room[50 : 50 + kept.sum()])


def test_spots_on_planes_are_those_of_the_plain_projections():
    rng = np.random.default_rng(12)
    voxels, normals = rng.integers(-50, 50, (200, 3)).astype(np.int32), unit_rows(rng, 200)
    heights = rng.uniform(-0.3, 0.3, 200)
    local = normals * heights[:, None]
    for _ in range(8):
        local = np.clip(local, -0.1996, 0.1996)
        local += normals * (heights - np.einsum("ij,ij->i", local, normals))[:, None]
    expected = (voxels + 0.5) * 0.4 + np.clip(local, -0.1996, 0.1996)
    np.testing.assert_allclose(spots_on_planes(voxels, normals, heights, 0.4), expected, atol=1e-5)


def test_planes_are_scored_as_by_numpy():
    rng = np.random.default_rng(13)
    normals, offsets, points = unit_rows(rng, 40), rng.uniform(-1, 1, 40), rng.normal(size=(300, 3))
    expected = scores_of_planes(normals, offsets, points, 0.3, 0.9)
    np.testing.assert_allclose(plane_scores(normals, offsets, points, 0.3, 0.9), expected, atol=1e-12)


def test_filtered_layers_are_those_of_numpy():
    rng = np.random.default_rng(14)
    filters = rng.uniform(size=(3, 8, 9)).astype(np.float32)
    spectrum = (rng.normal(size=(8, 9)) + 1j * rng.normal(size=(8, 9))).astype(np.complex64)
    products, total = np.empty((3, 8, 9), np.complex64), np.ones((6, 5), np.float32)
    multiply_spectrum(filters, spectrum, products)
    np.testing.assert_allclose(products, filters * spectrum, rtol=1e-6)
    add_amplitudes(products, total)
    np.testing.assert_allclose(total, 1.0 + np.abs(filters * spectrum).sum(axis=0)[:6, :5], rtol=1e-5)
    layers = rng.integers(0, 4, (5, 7, 8)).astype(np.float32)
    index, value = strongest_layer(layers)
    assert np.array_equal(index, layers.argmax(axis=0)) and np.array_equal(value, layers.max(axis=0))


@pytest.mark.parametrize("tall", [False, True])
def test_columns_are_sorted_as_by_numpy_and_keep_the_order_of_a_voxel(tall):
    rng = np.random.default_rng(15)
    spread = [1.0, 1.0, 40.0] if tall else [20.0, 15.0, 3.0]
    positions = (rng.uniform(-1, 1, (900, 3)) * spread).astype(np.float32)
    columns, voxels = columns_of(positions, 0.5), voxels_of(positions, 0.5)
    order = np.lexsort((voxels[:, 2], voxels[:, 1], voxels[:, 0]))
    assert np.array_equal(columns.rows, order) and np.array_equal(columns.points, positions[order])
    expected = (voxels[order, 0] - columns.low[0]) * columns.shape[1] + voxels[order, 1] - columns.low[1]
    assert np.array_equal(columns.keys, expected)
    assert np.array_equal(columns.grid, np.searchsorted(expected, np.arange(columns.shape.prod() + 1)))


def test_columns_higher_than_can_be_counted_are_sorted():
    positions = np.array([[0.1, 0.1, 0.7 * MAX_GRID], [0.2, 0.1, 0.1], [0.1, 0.3, 0.2], [0.9, 0.1, 0.3]], np.float32)
    columns = columns_of(positions, 0.5)
    assert columns.rows.tolist() == [1, 2, 0, 3] and len(columns.grid) == 0


@pytest.mark.parametrize("count", [6, 4])
def test_the_nearest_points_of_queries_above_each_other_are_those_of_each_alone(count):
    rng = np.random.default_rng(17)
    points = rng.uniform(-2, 2, (800, 3)).astype(np.float32)
    feet = rng.uniform(-2, 2, (60, 1, 2)).repeat(3, axis=1)
    queries = np.concatenate([feet, rng.uniform(-2, 2, (60, 3, 1))], axis=2).reshape(-1, 3).astype(np.float32)
    columns = columns_of(points, 0.4)
    rows, squared = nearest_points(queries, columns, 0.4, count, 2)
    alone = [nearest_points(query[None], columns, 0.4, count, 2) for query in queries]
    assert np.array_equal(rows, np.concatenate([one[0] for one in alone])) and (rows >= 0).sum() > 400
    assert np.array_equal(squared, np.concatenate([one[1] for one in alone]))


@pytest.mark.parametrize("limit", [1_000, 20])
def test_inserted_returns_are_summed_by_voxel_up_to_the_limit(limit):
    rng = np.random.default_rng(18)
    scans = [rng.uniform(-1, 1, (700, 3)).astype(np.float32).repeat(2, axis=0) for _ in range(2)]
    origins, records = np.array([[0, 0, 3], [0, 3, 0]], np.float32), np.empty((2_000, RECORD))
    table = VoxelTable(empty_slots(0), np.empty(2_000, np.int32), np.empty((2_000, 3), np.int32))
    size = 0
    for scan, points in enumerate(scans):
        size, done = insert_returns(points, 0, origins[scan], scan, table, records, size, 0.4, limit)
        assert done == len(points)
    every, voxels = np.concatenate(scans), [tuple(voxel) for voxel in voxels_of(np.concatenate(scans), 0.4)]
    known = list(dict.fromkeys(voxels))[:limit]
    assert [tuple(voxel) for voxel in table.voxels[:size]] == known
    assert min(limit, 125) <= size <= 216
    for row, voxel in enumerate(known):
        own = np.array([one == voxel for one in voxels])
        points, upper = every[own].astype(np.float64), np.triu_indices(3)
        views = np.repeat(origins, 1_400, axis=0)[own] - points
        views /= np.linalg.norm(views, axis=1, keepdims=True)
        seen = [scan for scan in range(2) if own[1_400 * scan : 1_400 * (scan + 1)].any()]
        sums = [own.sum(), *points.sum(axis=0), *(points.T @ points)[upper], *views.sum(axis=0)]
        np.testing.assert_allclose(records[row], [*sums, seen[0], seen[-1], len(seen)], rtol=1e-5, atol=1e-5)
