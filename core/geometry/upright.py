"""Which way is up in a cloud that comes without gravity: the direction that makes its surfaces level or upright.

Ground, roofs and floors are level, walls are upright. Both tell the vertical, so a sensor that sees no ground (one that
looks ahead) is served as well as one that sees little else.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.voxel_keys import grouped, voxel_keys

Array = NDArray[np.float64]

MAX_TILT_RAD = np.radians(40.0)
"""The z axis of the cloud must point up so far; a sensor that lies on its side is not served."""
MAX_POINTS = 60_000
MAX_NORMALS = 2_000
MIN_NORMALS = 30
MIN_VOXEL_POINTS = 8
VOXEL_OF_RANGE = 0.06
DIRECTIONS = 3_000
TOLERANCE_RAD = 0.05
MIN_SCORE = 0.25
"""The share of surfaces that must be level or upright: of real scans 0.36 to 0.9 are."""
LEAST_LEAN_RAD = float(np.radians(10.0))
"""The least tilt by which surfaces contradict a z that is said to point up: steeper roads are rare."""
BORNE_OUT = 0.5
"""The share of the vertical's own support with which surfaces bear out another direction."""
TELLING_WALLS = 0.02
"""The share of surfaces that are upright by one of two directions alone with which walls decide between them."""
RIVAL_RAD = np.radians(12.0)
RIVAL_SHARE = 0.95
_AT_ONCE = 32
"""Directions whose cosines with all normals fit into a processor's cache."""


@dataclass(frozen=True)
class UpAxis:
    """The vertical. `up` (3,) is a unit vector in the frame of the cloud; `support` the share 0..1 of its surfaces.

    `walls`: the share of surfaces that are upright by it and not by z, less the share that are by z and not by it; 0
    where that was not looked at.
    """

    up: Array
    support: float
    walls: float = 0.0

    @property
    def tilt_rad(self) -> float:
        """How far the z axis of the cloud is from the vertical."""
        return float(np.arccos(np.clip(self.up[2], -1.0, 1.0)))

    def T_level_cloud(self) -> se3.Matrix4:
        """The smallest rotation (4, 4) that turns the vertical to z."""
        return turned_up(self.up)


def turned_up(up: Array) -> se3.Matrix4:
    """The smallest rotation (4, 4) that turns a unit vector (3,) to z; about x where it points down."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9 and up[2] > 0.0:
        return np.eye(4)
    about = axis / sine if sine >= 1e-9 else np.array([1.0, 0.0, 0.0])
    return se3.exp(np.concatenate([np.zeros(3), about * float(np.arccos(np.clip(up[2], -1.0, 1.0)))]))


def estimate_up(points: NDArray[np.floating], seed: int = 0) -> UpAxis | None:
    """The vertical of a cloud (n, 3) of any scale, within 40 degrees of its z axis.

    None where there are too few surfaces, or where another direction, 12 degrees off or more, does nearly as well.
    """
    return _vertical(_drawn_normals(points, seed))


def contradicting_up(points: NDArray[np.floating], seed: int = 0) -> UpAxis | None:
    """The vertical of a cloud (n, 3) whose z should point up, where its surfaces contradict that (decision 0360).

    None where they do not tell (`estimate_up`), tell less than 10 degrees, or bear z out, too: all of them, or the
    walls, as on a slope.
    """
    normals, z = _drawn_normals(points, seed), np.array([0.0, 0.0, 1.0])
    borne_out = float(_scores(z[None], normals)[0]) if len(normals) else 1.0
    if borne_out >= BORNE_OUT:  # of any support
        return None
    up = _vertical(normals)
    if up is None or up.tilt_rad < LEAST_LEAN_RAD or borne_out >= BORNE_OUT * up.support:
        return None
    walls = _walls(up.up, z, normals) - _walls(z, up.up, normals)
    return None if walls <= -TELLING_WALLS else replace(up, walls=walls)


def _walls(up: Array, other: Array, normals: Array) -> float:
    """The share of normals (n, 3) that are square to `up` (3,), and not to `other` (3,), softly."""
    square, square_to_other = (np.exp(-0.5 * (normals @ one / TOLERANCE_RAD) ** 2) for one in (up, other))
    return float((square * (1.0 - square_to_other)).mean())


def _drawn_normals(points: NDArray[np.floating], seed: int) -> Array:
    normals = surface_normals(_near(points))
    return np.random.default_rng(seed).permutation(normals)[:MAX_NORMALS]


def _vertical(normals: Array) -> UpAxis | None:
    """The direction to which most normals (n, 3) are parallel or square; None where they are few, or do not tell."""
    if len(normals) < MIN_NORMALS:
        return None
    directions = _cap(DIRECTIONS)
    scores = _scores(directions, normals)
    best = int(scores.argmax())
    others = directions @ directions[best] < np.cos(RIVAL_RAD)
    if scores[best] < MIN_SCORE or float(scores[others].max(initial=0.0)) > RIVAL_SHARE * scores[best]:
        return None
    up = _refined(directions[best], normals)
    return UpAxis(up, float(_scores(up[None], normals)[0]))


def levelling(points: NDArray[np.floating]) -> se3.Matrix4:
    """T_level_cloud (4, 4) that turns a cloud (n, 3) upright by its own surfaces; no turn where these do not tell."""
    up = estimate_up(points)
    return np.eye(4) if up is None else up.T_level_cloud()


def surface_normals(points: NDArray[np.floating]) -> Array:
    """Unit normals (m, 3), of either sign, of the voxels in which the points (n, 3) lie on a plane."""
    if len(points) == 0:
        return np.empty((0, 3))
    median = float(np.median(_ranges(points)))
    voxels = np.floor(points / max(VOXEL_OF_RANGE * median, 1e-6)).astype(np.int64)
    voxel, counts = grouped(voxel_keys(voxels))
    axes = np.ascontiguousarray(points.T)
    means = np.stack([np.bincount(voxel, side) for side in axes]) / counts
    centred = axes - means.take(voxel, axis=1)
    spread = np.empty((len(counts), 3, 3))
    for row, column in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        spread[:, row, column] = np.bincount(voxel, centred[row] * centred[column]) / counts
        spread[:, column, row] = spread[:, row, column]
    values, vectors = np.linalg.eigh(spread[counts >= MIN_VOXEL_POINTS])
    flat = (values[:, 0] < 0.05 * values[:, 1]) & (values[:, 1] > 0.1 * values[:, 2])
    return np.asarray(vectors[flat, :, 0])


def _ranges(points: NDArray[np.floating]) -> NDArray[np.floating]:
    """The lengths (n,) of `points` (n, 3); NumPy's own norm goes row by row."""
    x, y, z = points.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def _near(points: NDArray[np.floating]) -> Array:
    ranges = _ranges(points)
    if len(points) == 0:
        return np.empty((0, 3))
    rows = np.flatnonzero((ranges > 0.0) & (ranges < 3.0 * np.median(ranges)))
    near = points.take(rows, axis=0).astype(np.float64)
    return np.asarray(near[:: max(1, len(near) // MAX_POINTS)])


def _cap(count: int) -> Array:
    """Directions (count, 3) spread evenly over the cap around z (a spiral of golden angles)."""
    index = np.arange(count)
    z = 1.0 - (1.0 - np.cos(MAX_TILT_RAD)) * (index + 0.5) / count
    angle, radius = index * (np.pi * (3.0 - np.sqrt(5.0))), np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def _scores(directions: Array, normals: Array) -> Array:
    """For each direction (d, 3) the share of normals (n, 3) along it or square to it, within some 3 degrees, softly."""
    scores, narrow = np.empty(len(directions)), 0.5 / TOLERANCE_RAD**2
    for start in range(0, len(directions), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        cosines = np.minimum(np.abs(directions[some] @ normals.T), 1.0)
        upright = np.exp(-narrow * cosines**2)
        # exp(narrow (cosine^2 - 1)): how near it is to level
        scores[some] = (upright + np.exp(-narrow) / upright).mean(axis=1)
    return scores


def _refined(up: Array, normals: Array) -> Array:
    """The best of the directions around `up`, three times finer each time."""
    offsets = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), axis=-1).reshape(-1, 2)
    for step in (0.02, 0.007, 0.002):
        across = np.cross(up, [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        along = np.cross(up, across)
        around = up + step * (offsets[:, :1] * across + offsets[:, 1:] * along)
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        up = around[_scores(around, normals).argmax()]
    return up
