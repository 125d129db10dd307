"""Cluster-guided projection, keypoints and patches of the bird's-eye view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from revisit.core.bev import describe_bev, reversed_patches
from revisit.core.bev.keypoints import context_histograms, describe_patches, dominant_orientations
from revisit.core.bev.log_gabor import OrientationMap
from revisit.core.bev.projection import cluster_supported, normalise, project
from revisit.core.clusters import Clusters
from revisit.core.config import BevConfig
from revisit.core.surface import Surface


def surface_of(occupied: list[tuple[int, int, int]], vertices: list[tuple[float, float, float]]) -> Surface:
    """A surface of given voxels of 0.4 m and vertices facing up."""
    points = np.array(vertices, dtype=np.float32)
    normals = np.tile(np.array([0, 0, 1], np.float32), (len(points), 1))
    faces = np.zeros((0, 3), np.int32)
    return Surface(points, normals, faces, np.array(occupied, np.int32), np.ones(len(occupied), np.float32), 0.4)


def clusters_of(labels: list[int], ground: list[bool]) -> Clusters:
    """Given labels."""
    return Clusters(np.array(labels, np.int32), max(labels, default=-1) + 1, np.array(ground, dtype=bool))


def test_only_voxels_within_delta_c_of_a_dominant_cluster_are_projected() -> None:
    surface = surface_of([(0, 0, 0), (1, 0, 0), (5, 0, 0)], [(0.2, 0.2, 0.2), (2.2, 0.2, 0.2)])
    clusters = clusters_of([0, -1], [False, True])
    supported = cluster_supported(surface, clusters, BevConfig(cluster_distance=0.5))
    assert supported.tolist() == [True, True, False]


def test_all_standing_voxels_are_projected_where_clusters_are_few() -> None:
    surface = surface_of([(0, 0, 0), (5, 0, 0), (9, 0, 0)], [(0.2, 0.2, 0.2), (2.2, 0.2, 0.2), (3.8, 0.2, 0.2)])
    clusters = clusters_of([-1, -1, -1], [False, False, True])
    assert cluster_supported(surface, clusters, BevConfig(cluster_distance=0.5)).tolist() == [True, True, False]


def test_a_pixel_adds_up_the_evidence_of_its_column() -> None:
    surface = surface_of([(0, 0, 0), (0, 0, 1), (0, 0, 2), (3, -2, 0)], [(0, 0, 0)])
    image = project(surface, np.ones(4, bool), BevConfig(half_range=4.0, normalisation="linear", saturation_quantile=1))
    assert image.shape == (20, 20)
    assert image[10, 10] == pytest.approx(1.0)  # row = y, column = x, the origin between the middle pixels
    assert image[8, 13] == pytest.approx(1 / 3)
    assert np.count_nonzero(image) == 2


@pytest.mark.parametrize(("name", "expected"), [("binary", 1.0), ("linear", 0.25), ("log", np.log(2) / np.log(5))])
def test_eta_maps_evidence_to_the_unit_interval(name: str, expected: float) -> None:
    sums = np.array([[0.0, 1.0], [4.0, 4.0]], dtype=np.float32)
    image = normalise(sums, BevConfig(normalisation=name, saturation_quantile=1.0))
    assert image[0, 0] == 0.0
    assert image[0, 1] == pytest.approx(expected, rel=1e-6)
    assert image[1, 1] == pytest.approx(1.0)


def test_an_empty_surface_has_no_keypoints() -> None:
    surface = surface_of([], [])
    surface = replace(surface, occupied=np.zeros((0, 3), np.int32), vertices=np.zeros((0, 3), np.float32))
    features = describe_bev(surface, clusters_of([], []), BevConfig())
    assert features.keypoints.shape == (0, 2)
    assert features.descriptors.shape == (0, 216)


def labelled(index: NDArray[np.int8]) -> OrientationMap:
    """A map of given labels with amplitude 1 everywhere."""
    return OrientationMap(index, np.ones(index.shape, np.float32), 6)


def test_the_orientation_of_a_keypoint_is_that_of_its_surroundings() -> None:
    flat = labelled(np.full((60, 60), 2, np.int8))
    histograms = context_histograms(flat, np.array([[30, 30]]), BevConfig(context_px=20))
    assert histograms[0].argmax() == 2
    assert dominant_orientations(histograms)[0] == pytest.approx(np.pi / 3, abs=1e-3)


def test_a_peak_between_two_bins_is_found_by_the_parabola() -> None:
    histogram = np.array([[0, 4, 4, 0, 0, 0]], dtype=np.float32)
    assert dominant_orientations(histogram)[0] == pytest.approx(1.5 * np.pi / 6)


def test_a_patch_is_counted_relative_to_the_orientation_of_its_keypoint() -> None:
    config = BevConfig(patch_px=12, patch_step=1, cells=1)
    flat = labelled(np.full((60, 60), 3, np.int8))
    histogram = describe_patches(flat, np.array([[30, 30]]), np.array([np.pi / 2], np.float32), config)
    np.testing.assert_allclose(histogram, [[1, 0, 0, 0, 0, 0]], atol=1e-3)


def test_a_patch_seen_upside_down_is_its_reversed_copy() -> None:
    config = BevConfig(patch_px=24, patch_step=1, cells=2)
    index = np.random.default_rng(0).integers(0, 6, (61, 61)).astype(np.int8)
    pixels = np.array([[30, 30]])
    upright = describe_patches(labelled(index), pixels, np.zeros(1, np.float32), config)
    turned = describe_patches(labelled(index[::-1, ::-1].copy()), pixels, np.zeros(1, np.float32), config)
    np.testing.assert_allclose(reversed_patches(upright, 2), turned, atol=1e-5)
    assert np.abs(upright - turned).max() > 0.01
