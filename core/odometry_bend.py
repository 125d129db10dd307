"""Odometry that turns steadily beside the truth within a submap, found from its own scans, and undone (decision 0081).

A heading that drifts by 0.3 degrees a metre bends 10 m of scans by 3 degrees: walls become thick, and a place resembles
neither itself nor others. One turn a metre explains all scans together, so that few planes suffice. The recorded poses
stay as they are: only the points are moved before they are described, about the middle scan, which is the frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.scan_planes import Planarity, PlaneHeights, SeenCubes, plane_heights, seen_cubes, within_planes
from revisit.core.submap import Submap

Array64 = NDArray[np.float64]


@dataclass(frozen=True)
class _Step:
    """A Gauss-Newton step: what counts as a plane, and the height, in edges, of which a pair weighs a quarter."""

    planarity: Planarity
    outlier: float


_LOOK = _Step(Planarity(1.0, 0.2, 0.2), 0.15)
_STEPS = (
    _Step(Planarity(2.0, 0.3, 0.3), 0.15), _Step(Planarity(2.0, 0.2, 0.2), 0.1), _LOOK,
    _Step(Planarity(1.0, 0.15, 0.15), 0.1), _Step(Planarity(), 0.05),
)  # fmt: skip
"""From coarse to fine: scans that lie half a metre apart share no plane in small cubes."""

_LIKELY_TURN, _LIKELY_SLIP = np.radians(0.3), 0.003  # a unit of way, standard deviations before any look
_HEIGHT_SIGMA = 0.03
_LEAST_PAIRS = 60
_LOOKS_BENT, _BENT, _MOST = np.radians((0.03, 0.05, 1.0)).tolist()  # a unit of way
_SURE = 4.0  # standard deviations


@dataclass(frozen=True)
class OdometryBend:
    """By how much the poses of a submap turn beside the truth, and how far they slip, by unit of way.

    turn (3,) radians about, and slip (3,) along, the axes of the submap.
    """

    turn: Array64
    slip: Array64

    def straightened(self, submap: Submap) -> Submap:
        """The submap with each scan where it lies without the bend."""
        from revisit.core.kernels.rigid_motion import moved_points  # compiled: the gateway needs none of it

        motions = -_motions(submap.origins.astype(np.float64)) @ np.concatenate([self.turn, self.slip])
        points, origins = submap.points.copy(), submap.origins.copy()
        ends = np.searchsorted(submap.scan_index, np.arange(submap.scan_count + 1))
        for scan, motion in enumerate(motions):
            T, rows = se3.exp(motion), slice(ends[scan], ends[scan + 1])
            moved_points(T, points[rows], in_place=True)
            origins[scan] = se3.apply(T, origins[scan : scan + 1])[0]
        return replace(submap, points=points, origins=origins)


def odometry_bend(submap: Submap, cubes: SeenCubes | None = None) -> OdometryBend | None:
    """How the odometry of a level submap bends; None where its scans show no bend, or too few planes.

    `cubes` are its `seen_cubes`, where they are at hand.
    """
    if submap.scan_count < 3:
        return None
    cubes = seen_cubes(submap, _LOOK.planarity.edge) if cubes is None else cubes
    looked = None if cubes is None else _motion(submap, cubes.heights(_LOOK.planarity), _LOOK)
    if looked is None or np.linalg.norm(looked[0][:3]) < _LOOKS_BENT:
        return None
    found, straight, deviation = np.zeros(6), submap, np.full(6, np.inf)
    for step in _STEPS:
        moved = _motion(straight, plane_heights(straight, step.planarity), step)
        if moved is None:
            return None
        found, deviation = found + moved[0], moved[1]
        straight = OdometryBend(found[:3], found[3:]).straightened(submap)
    turn = float(np.linalg.norm(found[:3]))
    if not max(_BENT, _SURE * float(deviation[:3].max())) <= turn <= _MOST:
        return None
    return OdometryBend(found[:3], found[3:])


def _motion(submap: Submap, pairs: PlaneHeights | None, step: _Step) -> tuple[Array64, Array64] | None:
    """Turn and slip (6,) by unit of way that lay the scans best on each other, and their standard deviations.

    By their heights over planes; None where there are too few.
    """
    edge = step.planarity.edge
    if pairs is None or len(pairs.height) < _LEAST_PAIRS // edge:
        return None
    starts = np.flatnonzero(np.diff(pairs.plane, prepend=-1))
    of_plane = np.diff(np.append(starts, len(pairs.plane)))
    height, motions = within_planes(pairs, starts, of_plane, submap.scan_count)
    bends = motions @ _motions(submap.origins.astype(np.float64) / edge).reshape(-1, 6)
    weighed = bends / (1.0 + (height / step.outlier) ** 2)[:, None] ** 2
    likely = np.array([_LIKELY_TURN * edge] * 3 + [_LIKELY_SLIP] * 3)
    information = weighed.T @ bends * (edge / _HEIGHT_SIGMA) ** 2 + np.diag(likely**-2)
    found = np.linalg.solve(information, weighed.T @ height * (edge / _HEIGHT_SIGMA) ** 2)
    to_unit = np.array([1.0 / edge] * 3 + [1.0] * 3)
    return to_unit * found, to_unit * np.sqrt(np.diag(np.linalg.inv(information)))


def _motions(origins: Array64) -> Array64:
    """The motion (s, 6, 6), tangents at the frame, of each scan taken at `origins` (s, 3) by turn and slip.

    The scan at the frame's origin does not move. Each turn on the way there moves all later scans aside, too.
    """
    middle, count = int(np.argmin((origins**2).sum(axis=1))), len(origins)
    steps = np.diff(origins, axis=0)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
    way -= way[middle]
    aside = np.zeros((count, 3, 3))  # the shift of each scan by a turn
    np.cumsum(-0.5 * (way[1:] + way[:-1])[:, None, None] * _crosses(steps), axis=0, out=aside[1:])
    aside -= aside[middle]
    motions = np.zeros((count, 6, 6))
    motions[:, :3, :3] = aside + way[:, None, None] * _crosses(origins)
    motions[:, 3:, :3] = motions[:, :3, 3:] = way[:, None, None] * np.eye(3)
    return motions


def _crosses(vectors: Array64) -> Array64:
    """The matrices (n, 3, 3) of the cross products with vectors (n, 3)."""
    return np.asarray(-np.cross(vectors[:, None, :], np.eye(3)[None]))
