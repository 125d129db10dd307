"""How high the scans of a submap lie over planes that several of them see, and how motions of the scans change it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.voxel_keys import grouped
from revisit.core.submap import Submap

Array64 = NDArray[np.float64]

_REACH_M = 30.0  # farther out, a cube holds few points of a scan
_POINTS = 30_000  # about so many are looked at: those of some columns of cubes
_LEAST_OF_SCAN, _LEAST_OF_CUBE = 5, 20
_FLATTEST_SPREAD_M2 = 0.015  # second eigenvalue: less is a line or a corner of the cube


@dataclass(frozen=True)
class Planarity:
    """What counts as a plane: the edge of the cubes in the submap's unit, the largest thickness (a standard deviation)
    in edges, and the largest share of the smallest in the second eigenvalue.

    Scans that do not yet lie on each other make thick planes.
    """

    edge: float = 1.0
    thickest: float = 0.1
    flat: float = 0.15


@dataclass(frozen=True)
class PlaneHeights:
    """How high scans lie over planes: height (k,) of each pair's points, its variance, the pair's plane and scan.

    middles and normals (k, 3) of the planes; the pairs of one plane follow each other. Lengths in edges of the cubes.
    """

    height: Array64
    variance: Array64
    plane: NDArray[np.int64]
    scan: NDArray[np.int64]
    middles: Array64
    normals: Array64


@dataclass(frozen=True)
class SeenCubes:
    """Cubes that at least two scans of a submap see, whatever counts as a plane: the mean (m, 3) of the points of each,
    the `axis` (m, 3) of their least variance, all three `variances` (m, 3) ascending; and of each scan (m, s) how many
    points it has there, their mean `height` along the axis, and its variance. Lengths as the points have them.
    """

    middles: Array64
    axis: Array64
    variances: Array64
    counts: NDArray[np.int64]
    height: Array64
    variance: Array64

    def heights(self, planarity: Planarity) -> PlaneHeights | None:
        """The heights of the scans over the planes among the cubes; None where there is none."""
        least, second = self.variances[:, 0], self.variances[:, 1]
        flat = (least < planarity.thickest**2) & (least < planarity.flat * second) & (second > _FLATTEST_SPREAD_M2)
        pairs = flat[:, None] & (self.counts >= _LEAST_OF_SCAN)
        plane, by = np.nonzero(pairs & (pairs.sum(axis=1, keepdims=True) >= 2))
        if len(plane) == 0:
            return None
        return PlaneHeights(
            self.height[plane, by], self.variance[plane, by], plane, by, self.middles[plane], self.axis[plane]
        )


def seen_cubes(submap: Submap, edge: float = 1.0) -> SeenCubes | None:
    """The cubes of an edge that at least two scans of a submap see; None where there are none."""
    return _seen(*_some_columns(submap, edge))


def plane_heights(submap: Submap, planarity: Planarity = Planarity()) -> PlaneHeights | None:
    """The heights of a submap's scans over planes that at least two of them see; None where there is no such plane."""
    cubes = seen_cubes(submap, planarity.edge)
    return None if cubes is None else cubes.heights(planarity)


def _some_columns(submap: Submap, edge: float) -> tuple[Array64, NDArray[np.int64], NDArray[np.int64]]:
    """Points (n, 3), their scans (n,) and cubes (n,) of an edge, of about _POINTS points: whole columns."""
    from revisit.core.kernels.drawn_columns import points_of_drawn_columns  # compiled: the gateway needs none of it

    scaled = submap.points if edge == 1.0 else submap.points * np.float32(1.0 / edge)
    rows = points_of_drawn_columns(scaled, _REACH_M / edge, _POINTS)
    points = submap.points.take(rows, axis=0)
    x, y, z = np.clip(np.floor(scaled.take(rows, axis=0).T).astype(np.int64) + 1024, 0, 2047)
    return points.astype(np.float64), submap.scan_index.take(rows).astype(np.int64), (x * 2048 + y) * 2048 + z


def _seen(points: Array64, scan: NDArray[np.int64], cube: NDArray[np.int64]) -> SeenCubes | None:
    """The cubes of points (n, 3) that at least two scans see; None where there is no such cube."""
    if len(points) < _LEAST_OF_CUBE:
        return None
    cube, _ = grouped(cube)
    scans = int(scan.max()) + 1
    counts = np.bincount(cube * scans + scan, minlength=(int(cube.max()) + 1) * scans).reshape(-1, scans)
    seen = ((counts >= _LEAST_OF_SCAN).sum(axis=1) >= 2) & (counts.sum(axis=1) >= _LEAST_OF_CUBE)
    if not seen.any():
        return None
    kept = np.flatnonzero(seen[cube])
    scan, cube, counts = scan[kept], (np.cumsum(seen) - 1)[cube[kept]], counts[seen]
    middles, axis, variances, above = _spreads(points.take(kept, axis=0).T.copy(), cube, counts.sum(axis=1))
    first, second = (
        np.bincount(cube * scans + scan, power, counts.size).reshape(counts.shape) / np.maximum(counts, 1)
        for power in (above, above**2)
    )
    of_mean = (second - first**2) / np.maximum(counts - 1, 1)
    return SeenCubes(middles, axis, variances, counts, first, of_mean)


def _spreads(
    points: Array64, cube: NDArray[np.int64], counts: NDArray[np.int64]
) -> tuple[Array64, Array64, Array64, Array64]:
    """Mean (m, 3) of the points (3, n) of each cube, axis of least variance (m, 3), variances (m, 3) ascending; and how
    high each point (n,) lies along that axis from the mean of its cube.
    """
    size = len(counts)
    middles = np.stack([np.bincount(cube, side, size) for side in points], axis=1) / counts[:, None]
    away, spread = points - middles.T.take(cube, axis=1), np.empty((size, 3, 3))
    for row in range(3):
        for column in range(row, 3):
            moment = np.bincount(cube, away[row] * away[column], size) / counts
            spread[:, row, column] = spread[:, column, row] = moment
    values, vectors = np.linalg.eigh(spread)
    axis = vectors[:, :, 0]
    return middles, axis, values, np.sum(away * axis.T.take(cube, axis=1), axis=0)


def within_planes(
    pairs: PlaneHeights, starts: NDArray[np.int64], of_plane: NDArray[np.int64], scans: int
) -> tuple[Array64, Array64]:
    """Heights (k,), and the effect of small motions of the scans (k, 6 scans), less the means of their planes."""
    motions = np.zeros((len(pairs.height), scans, 6))
    lever = np.cross(pairs.middles, pairs.normals)
    motions[np.arange(len(pairs.scan)), pairs.scan] = np.concatenate([pairs.normals, lever], axis=1)
    rows = np.column_stack([pairs.height, motions.reshape(len(pairs.height), -1)])
    rows -= np.repeat(np.add.reduceat(rows, starts, axis=0) / of_plane[:, None], of_plane, axis=0)
    return rows[:, 0], rows[:, 1:]
