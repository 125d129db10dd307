"""Disagreement between the scans of a submap on its planes: surface, a sensor mounted askew, single poses.

Loops between submaps whose scans disagree are off by more than their points say (docs/decisions/0081). What is left
after each scan has been moved to where it fits best is no error of its pose: beams that are off, surfaces that no two
scans see alike. And where the sensor looks beside the direction in which its poses move it, points ahead move
aside from scan to scan, by its angle times the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.submap import Submap

Array64 = NDArray[np.float64]

_REACH_M = 30.0  # farther out, a cube holds few points of a scan
_POINTS = 30_000  # about so many are looked at: those of some columns of cubes
_LEAST_OF_SCAN, _LEAST_OF_CUBE = 5, 20
_THICKEST_M = 0.1
_FLATTEST_SPREAD_M2 = 0.015  # second eigenvalue: less is a line or a corner of the cube
_FLAT = 0.15  # smallest over second eigenvalue
_OUTLIER_M = 0.05
_RIDGE = 1e-2
_OF_MENDED = 0.25  # a quarter of the variance of poses, decision 0081
_SPARE = 60  # heights of scans over planes that must remain beyond the unknowns
_LEAST_LEVER_M = 6.5  # scans that are thin share planes near the sensor alone, decision 0081
_LIKELY_SHIFT, _LIKELY_TURN = 0.01, np.radians(0.05)  # of a good odometry; motions told less sharply than so count less


@dataclass(frozen=True)
class ScanDisagreement:
    """surface: standard deviation across planes, in the submap's unit; askew: radians off the direction of travel.

    Of the error that motions of scans mend, little counts as surface: errors of single poses average out over scans.
    shift and turn: the error of the recorded pose of one scan, standard deviations along and about each axis,
    in the submap's unit and radians; 0 where that is not told.
    """

    surface: float
    askew: float
    shift: float = 0.0
    turn: float = 0.0


@dataclass(frozen=True)
class _PlaneHeights:
    """How high scans lie over planes: height (k,) of each pair's points, its variance, the pair's plane and scan.

    middles and normals (k, 3) of the planes; the pairs of one plane follow each other.
    """

    height: Array64
    variance: Array64
    plane: NDArray[np.int64]
    scan: NDArray[np.int64]
    middles: Array64
    normals: Array64


def scan_disagreement(submap: Submap) -> ScanDisagreement | None:
    """How far the scans of a submap disagree; None where too few planes are seen by two of them, or near ones alone.

    The submap is level, its lengths divided by the scene scale.
    """
    pairs = _plane_heights(*_some_columns(submap)) if submap.scan_count > 1 else None
    if pairs is None:
        return None
    starts = np.flatnonzero(np.diff(pairs.plane, prepend=-1))
    free, unknowns = len(pairs.height) - len(starts), 6 * (submap.scan_count - 1)
    if free - unknowns < _SPARE or _lever(pairs) < _LEAST_LEVER_M:
        return None
    of_plane = np.diff(np.append(starts, len(pairs.plane)))
    height, motions = _within_planes(pairs, starts, of_plane, submap.scan_count)
    weighed = motions / (1.0 + (height / _OUTLIER_M) ** 2)[:, None]
    normal, right = weighed.T @ motions + _RIDGE * np.eye(motions.shape[1]), weighed.T @ height
    moved = np.asarray(np.linalg.solve(normal, right), dtype=np.float64)
    left = height - motions @ moved
    own_share = np.sqrt(1.0 - 1.0 / np.repeat(of_plane, of_plane))  # the mean of a plane takes the rest
    unmended = _variance(left / own_share) / (1.0 - unknowns / free)
    mended = max(_variance(height / own_share) - unmended, 0.0) / submap.scan_count
    surface = np.sqrt(max(unmended - float(np.median(pairs.variance)), 0.0) + _OF_MENDED * mended)
    origins = submap.origins.astype(np.float64)
    single = _single_poses(normal, moved.reshape(-1, 6), unmended, origins)
    values = (float(surface), _askew(normal, right, origins), *single)
    return ScanDisagreement(*(round(value, 5) for value in values))


def _lever(pairs: _PlaneHeights) -> float:
    """The lever at which heights over the planes tell turns, root mean square."""
    return float(np.sqrt((np.cross(pairs.middles, pairs.normals) ** 2).sum(axis=1).mean()))


def _variance(values: Array64) -> float:
    """The variance of values around zero, by their median: some planes are none."""
    return float((1.4826 * np.median(np.abs(values))) ** 2)


def _askew(normal: Array64, right: Array64, origins: Array64) -> float:
    """The angle by which all scans would have to be turned against the way of their origins (s, 3), radians.

    `normal` and `right` are the normal equations of the scans' motions (shift and turn). Axes turned by w shift a scan
    taken at o by w x o. About the way itself a turn shifts nothing: the two axes across it are looked at.
    """
    way = origins - origins.mean(axis=0)
    across = np.linalg.svd(way)[2][1:]
    shifts = np.zeros((len(way), 6, 2))
    shifts[:, :3] = np.cross(across[None], way[:, None, :]).transpose(0, 2, 1)
    common = shifts.reshape(-1, 2)
    turn = np.linalg.solve(common.T @ normal @ common + _RIDGE * np.eye(2), common.T @ right)
    return float(np.linalg.norm(turn))


def _single_poses(normal: Array64, moved: Array64, variance: float, origins: Array64) -> tuple[float, float]:
    """How far the pose of a single scan is off, along and about each axis: the rest beside a line through all motions.

    `moved` (s, 6): the motions that mend the scans, with their `normal` matrix; `variance` of a height. Of a steady
    drift, as of a sensor askew, nothing counts; of a heading that walks, its bends do (docs/decisions/0081). What the
    motions' own errors explain is taken off, and axes along which they are told less sharply count less.
    """
    scans = len(origins)
    if scans < 3:
        return 0.0, 0.0
    at_origins = np.tile(np.eye(6), (scans, 1, 1))
    at_origins[:, :3, 3:] = -np.cross(origins[:, None, :], np.eye(3)[None]).transpose(0, 2, 1)
    line = np.vander(np.arange(scans) - 0.5 * (scans - 1), 2)
    off_line = np.eye(scans) - line @ np.linalg.pinv(line)
    off_line /= np.sqrt(np.diagonal(off_line))[:, None]  # each row has the variance of one scan
    of_all = np.eye(scans) - 1.0 / scans  # a motion of all scans is none
    bends = np.einsum("ks,sij,st->kitj", off_line, at_origins, of_all).reshape(-1, 6 * scans)
    bent = (bends @ moved.ravel()).reshape(-1, 6) ** 2
    of_errors = variance * np.einsum("ij,ji->i", bends, np.linalg.solve(normal, bends.T)).reshape(-1, 6)
    found = []
    for axes, likely in ((slice(0, 3), _LIKELY_SHIFT), (slice(3, 6), _LIKELY_TURN)):
        weights = (of_errors[:, axes] + likely**2) ** -2
        found.append(np.sqrt(max(np.average((bent - of_errors)[:, axes], weights=weights), 0.0)))
    return float(found[0]), float(found[1])


def _some_columns(submap: Submap) -> tuple[Array64, NDArray[np.int64], NDArray[np.int64]]:
    """Points (n, 3), their scans (n,) and cubes (n,) of 1 m, of about _POINTS points: whole columns."""
    from revisit.core.kernels.drawn_columns import points_of_drawn_columns  # compiled: the gateway needs none of it

    rows = points_of_drawn_columns(submap.points, _REACH_M, _POINTS)
    points = submap.points.take(rows, axis=0)
    x, y, z = np.clip(np.floor(points.T).astype(np.int64) + 1024, 0, 2047)
    return points.astype(np.float64), submap.scan_index.take(rows).astype(np.int64), (x * 2048 + y) * 2048 + z


def _plane_heights(points: Array64, scan: NDArray[np.int64], cube: NDArray[np.int64]) -> _PlaneHeights | None:
    """The heights of scans over the planes of cubes that at least two of them see; None where there is no such cube."""
    if len(points) < _LEAST_OF_CUBE:
        return None
    _, cube = np.unique(cube, return_inverse=True)
    scans = int(scan.max()) + 1
    counts = np.bincount(cube * scans + scan, minlength=(int(cube.max()) + 1) * scans).reshape(-1, scans)
    seen = ((counts >= _LEAST_OF_SCAN).sum(axis=1) >= 2) & (counts.sum(axis=1) >= _LEAST_OF_CUBE)
    if not seen.any():
        return None
    kept = np.flatnonzero(seen[cube])
    scan, cube, counts = scan[kept], (np.cumsum(seen) - 1)[cube[kept]], counts[seen]
    middles, normals, flat, above = _planes(points.take(kept, axis=0).T.copy(), cube, counts.sum(axis=1))
    first, second = (
        np.bincount(cube * scans + scan, power, counts.size).reshape(counts.shape) / np.maximum(counts, 1)
        for power in (above, above**2)
    )
    pairs = flat[:, None] & (counts >= _LEAST_OF_SCAN)
    plane, by = np.nonzero(pairs & (pairs.sum(axis=1, keepdims=True) >= 2))
    if len(plane) == 0:
        return None
    of_mean = (second - first**2) / np.maximum(counts - 1, 1)
    return _PlaneHeights(first[plane, by], of_mean[plane, by], plane, by, middles[plane], normals[plane])


def _planes(
    points: Array64, cube: NDArray[np.int64], counts: NDArray[np.int64]
) -> tuple[Array64, Array64, NDArray[np.bool_], Array64]:
    """The mean (m, 3) and the normal (m, 3) of the points (3, n) of each cube, and which of them lie on a plane; and
    how high each point (n,) lies over that of its cube.
    """
    size = len(counts)
    middles = np.stack([np.bincount(cube, side, size) for side in points], axis=1) / counts[:, None]
    away, spread = points - middles.T.take(cube, axis=1), np.empty((size, 3, 3))
    for row in range(3):
        for column in range(row, 3):
            moment = np.bincount(cube, away[row] * away[column], size) / counts
            spread[:, row, column] = spread[:, column, row] = moment
    values, vectors = np.linalg.eigh(spread)
    thin = (values[:, 0] < _THICKEST_M**2) & (values[:, 0] < _FLAT * values[:, 1])
    normals = vectors[:, :, 0]
    above = np.sum(away * normals.T.take(cube, axis=1), axis=0)
    return middles, normals, thin & (values[:, 1] > _FLATTEST_SPREAD_M2), above


def _within_planes(
    pairs: _PlaneHeights, starts: NDArray[np.int64], of_plane: NDArray[np.int64], scans: int
) -> tuple[Array64, Array64]:
    """Heights (k,), and the effect of small motions of the scans (k, 6 scans), less the means of their planes."""
    motions = np.zeros((len(pairs.height), scans, 6))
    lever = np.cross(pairs.middles, pairs.normals)
    motions[np.arange(len(pairs.scan)), pairs.scan] = np.concatenate([pairs.normals, lever], axis=1)
    rows = np.column_stack([pairs.height, motions.reshape(len(pairs.height), -1)])
    rows -= np.repeat(np.add.reduceat(rows, starts, axis=0) / of_plane[:, None], of_plane, axis=0)
    return rows[:, 0], rows[:, 1:]
