"""Saliency and angular histograms, by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from revisit.core.clusters import Clusters
from revisit.core.config import ANGLE_BINS, Evaluation, MicroConfig
from revisit.core.kernels.column_histograms import bin_of_angle
from revisit.core.micro.cluster_normals import angular_histogram, describe_clusters, regional_means, sphere_regions
from revisit.core.micro.saliency import Saliency, weigh_clusters
from revisit.core.surface import Surface


def two_walls() -> tuple[Surface, Clusters]:
    """A wall facing +x at x = 0 (cluster 0) and one facing +y at y = 20 (cluster 1), 8 m by 4 m each."""
    a, b = np.meshgrid(np.arange(0, 8, 0.4), np.arange(0, 4, 0.4))
    flat, height = a.ravel(), b.ravel()
    first = np.stack([np.zeros_like(flat), flat, height], axis=1)
    second = np.stack([flat, np.full_like(flat, 20.0), height], axis=1)
    normals = np.repeat(np.array([[1, 0, 0], [0, 1, 0]], np.float32), len(flat), axis=0)
    vertices = np.concatenate([first, second]).astype(np.float32)
    empty = np.zeros((0, 3), np.int32)
    surface = Surface(vertices, normals, empty, empty, np.zeros(0, np.float32), 0.4)
    labels = np.repeat(np.array([0, 1], np.int32), len(flat))
    return surface, Clusters(labels, 2, np.zeros(len(vertices), bool))


def test_keypoints_count_for_the_nearest_cluster_and_weights_are_positive() -> None:
    keypoints = np.array([[1, 1], [0.5, 3], [-2, 5], [4, 19]], dtype=np.float32)
    saliency = weigh_clusters(keypoints, *two_walls(), epsilon=0.5)
    assert saliency.assignment.tolist() == [0, 0, 0, 1]
    assert saliency.counts.tolist() == [3, 1]
    np.testing.assert_allclose(saliency.weights, [3.5 / 5.0, 1.5 / 5.0])


def test_the_sphere_has_72_regions_in_4_bands_of_18() -> None:
    degrees = np.arange(10.0, 360.0, 20.0)
    directions = [
        (np.cos(np.radians(lon)) * np.cos(np.radians(lat)), np.sin(np.radians(lon)) * np.cos(np.radians(lat)),
         np.sin(np.radians(lat)))
        for lat in (-60.0, -20.0, 20.0, 60.0) for lon in degrees
    ]  # fmt: skip
    assert sphere_regions(np.array(directions)).tolist() == list(range(72))


def test_three_known_normals_fall_into_three_known_bins() -> None:
    means = np.array([[1, 0, 0], [np.cos(np.radians(25)), np.sin(np.radians(25)), 0], [-1, 0, 0]])
    pairs = np.array([[0, 1], [0, 2], [1, 2]])  # 25, 180 and 155 degrees
    histogram = angular_histogram(means, pairs, np.zeros(3, np.int64), 1)
    assert np.flatnonzero(histogram).tolist() == [2, 15, 17]
    assert histogram.sum() == 3


def test_the_bin_of_an_angle_is_found_from_its_cosine() -> None:
    edges = np.cos(np.radians(np.arange(0.0, 181.0, 10.0)))
    beside = np.concatenate([np.nextafter(edges, -2.0), edges, np.nextafter(edges, 2.0), [0.0, 0.5, -0.5]])
    cosines = np.clip(np.concatenate([beside, np.random.default_rng(0).uniform(-1.0, 1.0, 5_000)]), -1.0, 1.0)
    expected = [min(int(math.acos(one) / np.pi * ANGLE_BINS), ANGLE_BINS - 1) for one in cosines.tolist()]
    assert [bin_of_angle(one) for one in cosines.tolist()] == expected
    assert set(expected) == set(range(ANGLE_BINS))


def test_a_region_has_the_mean_normal_of_its_points() -> None:
    points = np.array([[1, 0.1, 0.1], [1, 0.11, 0.1], [-1, 0.1, 0.1]])
    normals = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    means, places = regional_means(points, normals)
    np.testing.assert_allclose(means, [[0.5**0.5, 0.5**0.5, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(places[0], [1, 0.105, 0.1])


@pytest.mark.parametrize("evaluation", list(Evaluation))
def test_a_flat_wall_has_only_angles_near_zero(evaluation: Evaluation) -> None:
    surface, clusters = two_walls()
    config = MicroConfig(evaluation=evaluation, distance_bins=1)
    keypoints = np.array([[0, 4], [4, 20]], dtype=np.float32)
    saliency = weigh_clusters(keypoints, surface, clusters, 0.5)
    statistics = describe_clusters(surface, clusters, keypoints, saliency, config, np.random.default_rng(0))
    expected = np.zeros((2, 18))
    expected[:, 0] = 1.0
    np.testing.assert_allclose(statistics.histograms, expected)
    np.testing.assert_allclose(statistics.weights, [0.5, 0.5])


def test_a_place_without_clusters_has_no_statistics() -> None:
    surface, clusters = two_walls()
    none = Clusters(np.full(len(clusters.labels), -1, np.int32), 0, clusters.ground)
    keypoints = np.zeros((3, 2), np.float32)
    saliency = weigh_clusters(keypoints, surface, none, 0.5)
    assert isinstance(saliency, Saliency)
    result = describe_clusters(surface, none, keypoints, saliency, MicroConfig(), np.random.default_rng(0))
    assert result.histograms.shape == (0, 54)
