"""Angular statistics of the regional mean normals of the dominant clusters, psi(C_m) (paper III-C, Fig. 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.clusters import Clusters
from revisit.core.config import MicroConfig
from revisit.core.micro.saliency import Saliency
from revisit.core.surface import Surface

Array = NDArray[np.float32]

LATITUDE_BANDS = 4
SECTORS = 18
REGIONS = LATITUDE_BANDS * SECTORS
ANGLE_BINS = 18


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
    if config.evaluation == "keypoint":
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
    histograms = _column_histograms(
        surface.vertices[order], surface.normals[order], bounds, keypoints, saliency.assignment,
        config.radius, config.distance_bins, config.height_bins,
    )  # fmt: skip
    return histograms, saliency.weights[saliency.assignment] / saliency.counts[saliency.assignment]


@numba.njit(cache=True, fastmath=False)
def _column_histograms(
    vertices: Array,
    normals: Array,
    bounds: NDArray[np.int64],
    keypoints: Array,
    assignment: NDArray[np.int32],
    radius: float,
    distance_bins: int,
    height_bins: int,
) -> NDArray[np.float64]:
    """As `angular_histogram` over all pairs of regions, for the column of `radius` metres around each keypoint.

    Column vertices: horizontal distance below `radius`, their mean height is the centre of the sphere.
    """
    histograms = np.zeros((len(keypoints), distance_bins * height_bins * 18))
    for k in range(len(keypoints)):
        sums = np.zeros((72, 7))
        first, last = bounds[assignment[k]], bounds[assignment[k] + 1]
        centre_z, members = 0.0, 0
        inside = np.empty(last - first, dtype=np.int64)
        for i in range(first, last):
            dx, dy = vertices[i, 0] - keypoints[k, 0], vertices[i, 1] - keypoints[k, 1]
            if dx * dx + dy * dy < radius * radius:
                inside[members] = i
                members += 1
                centre_z += vertices[i, 2]
        if members < 8:
            continue
        centre_z /= members
        sxx, sxy, syy = 0.0, 0.0, 0.0
        for n in range(members):
            dx, dy = vertices[inside[n], 0] - keypoints[k, 0], vertices[inside[n], 1] - keypoints[k, 1]
            sxx += dx * dx
            sxy += dx * dy
            syy += dy * dy
        axis = 0.5 * np.arctan2(2.0 * sxy, sxx - syy)
        for n in range(members):
            i = inside[n]
            dx, dy = vertices[i, 0] - keypoints[k, 0], vertices[i, 1] - keypoints[k, 1]
            dz = vertices[i, 2] - centre_z
            latitude = np.arctan2(dz, np.sqrt(dx * dx + dy * dy)) + 0.5 * np.pi
            longitude = (np.arctan2(dy, dx) - axis) % (2.0 * np.pi)
            region = min(int(latitude / np.pi * 4), 3) * 18 + min(int(longitude / (2.0 * np.pi) * 18), 17)
            for a in range(3):
                sums[region, a] += normals[i, a]
            sums[region, 3] += dx
            sums[region, 4] += dy
            sums[region, 5] += dz
            sums[region, 6] += 1.0
        _count_pairs(sums, radius, distance_bins, height_bins, histograms[k])
    return histograms


@numba.njit(cache=True)
def _count_pairs(
    sums: NDArray[np.float64], radius: float, distance_bins: int, height_bins: int, histogram: NDArray[np.float64]
) -> None:
    means = np.zeros((72, 6))
    occupied = 0
    for region in range(72):
        length = np.sqrt(sums[region, 0] ** 2 + sums[region, 1] ** 2 + sums[region, 2] ** 2)
        if sums[region, 6] == 0.0 or length <= 1e-6 * sums[region, 6]:
            continue
        for a in range(3):
            means[occupied, a] = sums[region, a] / length
            means[occupied, 3 + a] = sums[region, 3 + a] / sums[region, 6]
        occupied += 1
    for i in range(occupied):
        for j in range(i + 1, occupied):
            cosine = means[i, 0] * means[j, 0] + means[i, 1] * means[j, 1] + means[i, 2] * means[j, 2]
            angle = np.arccos(min(max(cosine, -1.0), 1.0))
            angle_bin = min(int(angle / np.pi * 18), 17)
            gap = np.sqrt((means[i, 3] - means[j, 3]) ** 2 + (means[i, 4] - means[j, 4]) ** 2) / (2.0 * radius)
            height = abs(means[i, 5] - means[j, 5]) / radius
            pair = min(int(gap * distance_bins), distance_bins - 1) * height_bins
            pair += min(int(height * height_bins), height_bins - 1)
            histogram[pair * 18 + angle_bin] += 1.0
