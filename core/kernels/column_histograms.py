"""Angles between the regional mean normals of the column around each keypoint (paper III-C)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.arcs import arc_tangent

Array = NDArray[np.float32]

LATITUDE_BANDS = 4
SECTORS = 18
REGIONS = LATITUDE_BANDS * SECTORS
ANGLE_BINS = 18
MIN_MEMBERS = 8
"""Fewer vertices in a column say nothing."""


@numba.njit(cache=True, error_model="numpy")
def column_histograms(
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
    histograms = np.zeros((len(keypoints), distance_bins * height_bins * ANGLE_BINS))
    for k in range(len(keypoints)):
        sums = np.zeros((REGIONS, 7))
        first, last = bounds[assignment[k]], bounds[assignment[k] + 1]
        centre_z, members = 0.0, 0
        inside = np.empty(last - first, dtype=np.int64)
        for i in range(first, last):
            dx, dy = vertices[i, 0] - keypoints[k, 0], vertices[i, 1] - keypoints[k, 1]
            if dx * dx + dy * dy < radius * radius:
                inside[members] = i
                members += 1
                centre_z += vertices[i, 2]
        if members < MIN_MEMBERS:
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
            latitude = arc_tangent(dz, np.sqrt(dx * dx + dy * dy)) + 0.5 * np.pi
            longitude = arc_tangent(dy, dx) - axis
            longitude = longitude + 2.0 * np.pi if longitude < 0.0 else longitude
            band = min(int(latitude / np.pi * LATITUDE_BANDS), LATITUDE_BANDS - 1)
            sector = min(int(longitude / (2.0 * np.pi) * SECTORS), SECTORS - 1)
            region = band * SECTORS + sector
            for a in range(3):
                sums[region, a] += normals[i, a]
            sums[region, 3] += dx
            sums[region, 4] += dy
            sums[region, 5] += dz
            sums[region, 6] += 1.0
        _count_pairs(sums, radius, distance_bins, height_bins, histograms[k])
    return histograms


@numba.njit(cache=True, error_model="numpy")
def _count_pairs(
    sums: NDArray[np.float64], radius: float, distance_bins: int, height_bins: int, histogram: NDArray[np.float64]
) -> None:
    means = np.zeros((REGIONS, 6))
    occupied = 0
    for region in range(REGIONS):
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
            angle_bin = min(int(angle / np.pi * ANGLE_BINS), ANGLE_BINS - 1)
            gap = np.sqrt((means[i, 3] - means[j, 3]) ** 2 + (means[i, 4] - means[j, 4]) ** 2) / (2.0 * radius)
            height = abs(means[i, 5] - means[j, 5]) / radius
            pair = min(int(gap * distance_bins), distance_bins - 1) * height_bins
            pair += min(int(height * height_bins), height_bins - 1)
            histogram[pair * ANGLE_BINS + angle_bin] += 1.0
