"""Angular statistics of the regional mean normals of the dominant clusters, psi(C_m) (paper III-C, Fig. 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.clusters import Clusters
from revisit.core.config import ANGLE_BINS, Evaluation, MicroConfig
from revisit.core.kernels.column_histograms import LATITUDE_BANDS, REGIONS, SECTORS, column_histograms
from revisit.core.micro.saliency import Saliency
from revisit.core.stages import stage
from revisit.core.surface import Surface

Array = NDArray[np.float32]


@dataclass(frozen=True)
class ClusterStatistics:
    """The micro features of a submap.

    histograms (e, d) float32, Hellinger mapped unit vectors, one for each evaluation; weights (e,) float64, such that
    the evaluations of cluster m share its alpha_m.
    """

    histograms: Array
    weights: NDArray[np.float64]


def histogram_size(config: MicroConfig) -> int:
    """The length d of one evaluation: 18 angle bins for each class of pairs."""
    return ANGLE_BINS * config.distance_bins * config.height_bins


@stage("micro")
def describe_clusters(
    surface: Surface,
    clusters: Clusters,
    keypoints: Array,
    saliency: Saliency,
    config: MicroConfig,
    rng: np.random.Generator,
) -> ClusterStatistics:
    """psi of every cluster, evaluated as often as its saliency s_m says.

    `config.evaluation` = "keypoint": one evaluation at each keypoint (n, 2) of the cluster, over the cluster's vertices
    in the column of `radius` around it (Fig. 2b: the keypoints of a cluster govern its number of evaluations); all
    pairs of regions count. "cluster": the literal III-C, one evaluation over the whole cluster, scaled into the unit
    sphere, of n_m random pairs, n_m growing with s_m.
    """
    if config.evaluation is Evaluation.KEYPOINT:
        counts, weights = _at_keypoints(surface, clusters, keypoints, saliency, config)
    else:
        counts, weights = _of_whole_clusters(surface, clusters, saliency, config, rng)
    totals = counts.sum(axis=1)
    kept = totals > 0
    shares = counts[kept] / totals[kept, None]
    return ClusterStatistics(np.sqrt(shares).astype(np.float32), weights[kept])


def angular_histogram(
    means: NDArray[np.float64], pairs: NDArray[np.int64], classes: NDArray[np.int64], class_count: int
) -> NDArray[np.float64]:
    """Counts (18 * class_count,) of the angles between regional mean normals (paper III-C).

    means (n, 3) unit vectors; pairs (p, 2) rows of it; classes (p,) in 0..class_count-1. Bins of 10 degrees.
    """
    cosine = np.einsum("ij,ij->i", means[pairs[:, 0]], means[pairs[:, 1]])
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    bins = np.minimum((angle / (180.0 / ANGLE_BINS)).astype(np.int64), ANGLE_BINS - 1)
    return np.bincount(classes * ANGLE_BINS + bins, minlength=ANGLE_BINS * class_count).astype(np.float64)


def sphere_regions(directions: NDArray[np.float64]) -> NDArray[np.int64]:
    """The region 0..71 of each direction (n, 3): 4 latitude bands of 45 degrees times 18 sectors of 20 degrees."""
    horizontal = np.hypot(directions[:, 0], directions[:, 1])
    latitude = np.degrees(np.arctan2(directions[:, 2], horizontal)) + 90.0
    longitude = np.degrees(np.arctan2(directions[:, 1], directions[:, 0])) % 360.0
    band = np.clip((latitude / (180.0 / LATITUDE_BANDS)).astype(np.int64), 0, LATITUDE_BANDS - 1)
    sector = np.clip((longitude / (360.0 / SECTORS)).astype(np.int64), 0, SECTORS - 1)
    return np.asarray(band * SECTORS + sector)


def regional_means(
    points: NDArray[np.float64], normals: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean unit normal (r, 3) and mean position (r, 3) of each occupied region of points (n, 3) around the origin."""
    regions = sphere_regions(points)
    counts = np.bincount(regions, minlength=REGIONS)
    sums = np.stack([np.bincount(regions, normals[:, axis], REGIONS) for axis in range(3)], axis=1)
    places = np.stack([np.bincount(regions, points[:, axis], REGIONS) for axis in range(3)], axis=1)
    length = np.linalg.norm(sums, axis=1)
    kept = (counts > 0) & (length > 1e-6 * np.maximum(counts, 1))
    return sums[kept] / length[kept, None], places[kept] / counts[kept, None]


def aligned_to_unit_sphere(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (n, 3) centred, turned about z so that their principal horizontal axis is x, and scaled to radius 1.

    Also returns the rotation (3, 3). The 180 degree ambiguity of the axis permutes whole sectors and changes no
    angle between regions.
    """
    centred = points - points.mean(axis=0)
    angle = 0.5 * np.arctan2(
        2.0 * (centred[:, 0] * centred[:, 1]).sum(), (centred[:, 0] ** 2 - centred[:, 1] ** 2).sum()
    )
    cosine, sine = np.cos(angle), np.sin(angle)
    rotation = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    radius = max(float(np.linalg.norm(centred, axis=1).max()), 1e-9)
    return centred @ rotation.T / radius, rotation


def pair_classes(
    places: NDArray[np.float64], pairs: NDArray[np.int64], reach: float, config: MicroConfig
) -> NDArray[np.int64]:
    """The class (p,) of each pair of regions by the horizontal distance and height difference of their mean positions.

    `reach` is the radius of the sphere in the unit of `places`. One bin of each makes the literal histogram.
    """
    difference = places[pairs[:, 0]] - places[pairs[:, 1]]
    distance = np.hypot(difference[:, 0], difference[:, 1]) / (2.0 * reach)
    height = np.abs(difference[:, 2]) / reach
    distance_bin = np.minimum((distance * config.distance_bins).astype(np.int64), config.distance_bins - 1)
    height_bin = np.minimum((height * config.height_bins).astype(np.int64), config.height_bins - 1)
    return np.asarray(distance_bin * config.height_bins + height_bin)


def _of_whole_clusters(
    surface: Surface, clusters: Clusters, saliency: Saliency, config: MicroConfig, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    histograms = np.zeros((clusters.count, histogram_size(config)))
    for cluster in range(clusters.count):
        rows = clusters.labels == cluster
        points, rotation = aligned_to_unit_sphere(surface.vertices[rows].astype(np.float64))
        means, places = regional_means(points, surface.normals[rows].astype(np.float64) @ rotation.T)
        if len(means) < 2:
            continue
        pairs = np.stack(np.triu_indices(len(means), 1), axis=1)
        wanted = min(len(pairs), round(config.pairs_per_keypoint * (1.0 + float(saliency.counts[cluster]))))
        pairs = pairs[rng.choice(len(pairs), wanted, replace=False)]
        classes = pair_classes(places, pairs, 1.0, config)
        histograms[cluster] = angular_histogram(means, pairs, classes, config.distance_bins * config.height_bins)
    return histograms, saliency.weights


def _at_keypoints(
    surface: Surface, clusters: Clusters, keypoints: Array, saliency: Saliency, config: MicroConfig
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    if clusters.count == 0 or len(keypoints) == 0:
        return np.zeros((0, histogram_size(config))), np.zeros(0)
    order = np.argsort(clusters.labels, kind="stable")
    bounds = np.searchsorted(clusters.labels[order], np.arange(clusters.count + 1))
    histograms = column_histograms(
        surface.vertices.take(order, axis=0), surface.normals.take(order, axis=0), bounds, keypoints,
        saliency.assignment, config.radius, config.distance_bins, config.height_bins,
    )  # fmt: skip
    return histograms, saliency.weights[saliency.assignment] / saliency.counts[saliency.assignment]
