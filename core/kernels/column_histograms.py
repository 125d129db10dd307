"""Angles between the regional mean normals of the column around each keypoint (paper III-C)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import ANGLE_BINS
from revisit.core.kernels.arcs import arc_tangent
from revisit.core.kernels.loops import compiled, inlined, inner

Array = NDArray[np.float32]

LATITUDE_BANDS = 4
SECTORS = 18
REGIONS = LATITUDE_BANDS * SECTORS
MIN_MEMBERS = 8
"""Fewer vertices in a column say nothing."""

_SLOTS = 256  # of cosines: fine enough that no two edges of bins lie in one


def _edges_of_bins() -> NDArray[np.float64]:
    """The greatest cosine (ANGLE_BINS,) of an angle beyond each bin; below all cosines for the last one."""
    edges = np.full(ANGLE_BINS, -2.0)
    for angle_bin in range(ANGLE_BINS - 1):
        beyond, within = -1.0, 1.0
        while beyond < (middle := 0.5 * (beyond + within)) < within:
            if int(math.acos(middle) / np.pi * ANGLE_BINS) > angle_bin:
                beyond = middle
            else:
                within = middle
        edges[angle_bin] = beyond
    return edges


_EDGES = _edges_of_bins()
_FIRST_BINS = np.array([int((2.0 * (slot + 1) / _SLOTS - 1.0 <= _EDGES).sum()) for slot in range(_SLOTS + 1)])
"""The bin of the greatest cosine in each slot."""


@compiled
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
    sums, inside = np.empty((REGIONS, 7)), np.empty(len(vertices), dtype=np.int64)
    away, regions = np.empty((3, len(vertices))), np.empty(len(vertices), dtype=np.int64)
    means = np.empty((REGIONS, 6))
    for k in range(len(keypoints)):
        first, last = bounds[assignment[k]], bounds[assignment[k] + 1]
        members = _find_members(vertices, first, last, keypoints[k, 0], keypoints[k, 1], radius, inside, away)
        if members < MIN_MEMBERS:
            continue
        _find_regions(away, members, regions)
        sums[:] = 0.0
        for n in range(members):
            region, i = regions[n], inside[n]
            for a in range(3):
                sums[region, a] += normals[i, a]
                sums[region, 3 + a] += away[a, n]
            sums[region, 6] += 1.0
        _count_pairs(sums, means, radius, distance_bins, height_bins, histograms[k])
    return histograms


@inlined
def _find_members(
    vertices: Array, first: int, last: int, x: np.float32, y: np.float32, radius: float, inside: NDArray[np.int64],
    away: NDArray[np.float64],
) -> int:  # fmt: skip
    """List in `inside` the vertices of the column around (x, y), and in `away` (3, ...) where they lie from its middle.

    Returns how many there are.
    """
    members, height = 0, 0.0
    for i in range(first, last):
        dx, dy = vertices[i, 0] - x, vertices[i, 1] - y
        if dx * dx + dy * dy < radius * radius:
            inside[members], away[0, members], away[1, members] = i, dx, dy
            members += 1
            height += vertices[i, 2]
    if members:
        height /= members
    for n in range(members):
        away[2, n] = vertices[inside[n], 2] - height
    return members


@inlined
def _find_regions(away: NDArray[np.float64], members: int, regions: NDArray[np.int64]) -> None:
    """The region of each of the first `members` places `away` (3, ...), turned by their principal horizontal axis."""
    sxx, sxy, syy = 0.0, 0.0, 0.0
    for n in range(members):
        sxx += away[0, n] * away[0, n]
        sxy += away[0, n] * away[1, n]
        syy += away[1, n] * away[1, n]
    axis = 0.5 * np.arctan2(2.0 * sxy, sxx - syy)
    for n in range(np.uint64(members)):  # without a branch, so that several are done at once
        dx, dy = away[0, n], away[1, n]
        latitude = arc_tangent(away[2, n], np.sqrt(dx * dx + dy * dy)) + 0.5 * np.pi
        longitude = arc_tangent(dy, dx) - axis
        longitude = longitude + 2.0 * np.pi if longitude < 0.0 else longitude
        band = min(int(latitude / np.pi * LATITUDE_BANDS), LATITUDE_BANDS - 1)
        sector = min(int(longitude / (2.0 * np.pi) * SECTORS), SECTORS - 1)
        regions[n] = band * SECTORS + sector


@inner
def _count_pairs(
    sums: NDArray[np.float64], means: NDArray[np.float64], radius: float, distance_bins: int, height_bins: int,
    histogram: NDArray[np.float64],
) -> None:  # fmt: skip
    """Add up the `histogram` (distance, height, angle) of pairs of regions; `means` (REGIONS, 6) is for its use."""
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
            angle_bin = bin_of_angle(min(max(cosine, -1.0), 1.0))
            gap = np.sqrt((means[i, 3] - means[j, 3]) ** 2 + (means[i, 4] - means[j, 4]) ** 2) / (2.0 * radius)
            height = abs(means[i, 5] - means[j, 5]) / radius
            pair = min(int(gap * distance_bins), distance_bins - 1) * height_bins
            pair += min(int(height * height_bins), height_bins - 1)
            histogram[pair * ANGLE_BINS + angle_bin] += 1.0


@inlined
def bin_of_angle(cosine: float) -> int:
    """The bin of the angle with this `cosine`, in [-1, 1], without an arc cosine."""
    first = _FIRST_BINS[int((cosine + 1.0) * (0.5 * _SLOTS))]
    return int(first + (1 if cosine <= _EDGES[first] else 0))
