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

from revisit.core.scan_planes import Planarity, PlaneHeights, SeenCubes, seen_cubes, within_planes
from revisit.core.submap import Submap

Array64 = NDArray[np.float64]

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


def scan_disagreement(submap: Submap, cubes: SeenCubes | None = None) -> ScanDisagreement | None:
    """How far the scans of a submap disagree; None where too few planes are seen by two of them, or near ones alone.

    The submap is level, its lengths divided by the scene scale. `cubes` are its `seen_cubes`, where they are at hand.
    """
    if submap.scan_count < 2:
        return None
    cubes = seen_cubes(submap) if cubes is None else cubes
    pairs = None if cubes is None else cubes.heights(Planarity())
    if pairs is None:
        return None
    starts = np.flatnonzero(np.diff(pairs.plane, prepend=-1))
    free, unknowns = len(pairs.height) - len(starts), 6 * (submap.scan_count - 1)
    if free - unknowns < _SPARE or _lever(pairs) < _LEAST_LEVER_M:
        return None
    of_plane = np.diff(np.append(starts, len(pairs.plane)))
    height, motions = within_planes(pairs, starts, of_plane, submap.scan_count)
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


def _lever(pairs: PlaneHeights) -> float:
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
