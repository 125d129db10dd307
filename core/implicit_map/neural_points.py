"""Elastic neural points (paper III-B 1 and 3, Eq. 1): insertion, eviction, movement, stability.

A neural point m = (p, q, f, t_c, t_u, mu) lives in one voxel. Its position follows the mean of the returns seen there,
its orientation q turns the local z axis to the surface normal on the side of the sensor, so that the decoder sees the
surface in a frame of its own (Eq. 2) whatever the heading of the robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.implicit_map import voxel_hash

Array = NDArray[np.float32]

NORMAL_PRIOR = 0.05
POOLED_RETURNS = 8.0


@dataclass(frozen=True)
class NeuralPoints:
    """The points of one submap, Eq. 1 without the latent features.

    positions (n, 3) and normals (n, 3) float32; created and updated (n,) int16, the scans of t_c and t_u;
    hits (n,) int16, scans that saw a return here; stability (n,) float32, mu.
    """

    positions: Array
    normals: Array
    created: NDArray[np.int16]
    updated: NDArray[np.int16]
    hits: NDArray[np.int16]
    stability: Array

    def __len__(self) -> int:
        return len(self.positions)

    def subset(self, keep: NDArray[np.bool_]) -> NeuralPoints:
        """Only the points where `keep` (n,) holds."""
        return NeuralPoints(
            self.positions[keep], self.normals[keep], self.created[keep], self.updated[keep], self.hits[keep],
            self.stability[keep],
        )  # fmt: skip


class ElasticAccumulator:
    """Takes scan after scan and keeps one elastic neural point a voxel."""

    def __init__(self, resolution: float, eviction_distance: float) -> None:
        self._resolution = resolution
        self._eviction_distance = eviction_distance
        self._slots = np.full(1 << voxel_hash.TABLE_BITS, -1, dtype=np.int32)
        self._moments = np.zeros((0, 10))
        self._views = np.zeros((0, 3))
        self._scans = np.zeros((0, 3), dtype=np.int16)
        self._size = 0

    def insert(self, points: Array, origin: Array, scan: int) -> None:
        """Insert the returns (n, 3) of scan number `scan`, taken from `origin` (3,), all in the submap frame.

        A return in an empty slot creates a neural point; one within the eviction distance of the stored point moves
        it; one farther away evicts and replaces it (paper III-B 3).
        """
        self._reserve(self._size + len(points))
        self._size = _insert(
            points, origin, scan, self._slots, self._moments, self._views, self._scans, self._size,
            self._resolution, self._eviction_distance,
        )  # fmt: skip

    def finish(self) -> NeuralPoints:
        """The points accumulated so far, with their orientations."""
        moments, views = self._moments[: self._size], self._views[: self._size]
        scans = self._scans[: self._size]
        positions = (moments[:, 1:4] / moments[:, :1]).astype(np.float32)
        pooled = _pooled_covariances(positions, moments, self._slots, self._resolution)
        normals = _oriented_normals(pooled, views)
        return NeuralPoints(
            positions=positions, normals=normals, created=scans[:, 0].copy(), updated=scans[:, 1].copy(),
            hits=scans[:, 2].copy(), stability=scans[:, 2].astype(np.float32),
        )  # fmt: skip

    def _reserve(self, size: int) -> None:
        if size <= len(self._moments):
            return
        grown = max(size, 2 * len(self._moments))
        for name in ("_moments", "_views", "_scans"):
            old = getattr(self, name)
            new = np.zeros((grown, old.shape[1]), dtype=old.dtype)
            new[: len(old)] = old
            setattr(self, name, new)


@numba.njit(cache=True)
def _insert(
    points: Array,
    origin: Array,
    scan: int,
    slots: NDArray[np.int32],
    moments: NDArray[np.float64],
    views: NDArray[np.float64],
    scans: NDArray[np.int16],
    size: int,
    resolution: float,
    eviction_distance: float,
) -> int:
    """Insert, move or replace; returns the new number of points. Moments are (count, sum p, sum p p^T upper)."""
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        slot = voxel_hash.slot_of(
            int(np.floor(x / resolution)), int(np.floor(y / resolution)), int(np.floor(z / resolution))
        )
        i = slots[slot]
        fresh = i < 0
        if fresh:
            i = size
            size += 1
            slots[slot] = i
        else:
            c = moments[i, 0]
            gap = (x - moments[i, 1] / c) ** 2 + (y - moments[i, 2] / c) ** 2 + (z - moments[i, 3] / c) ** 2
            fresh = gap > eviction_distance**2
        if fresh:
            moments[i] = 0.0
            views[i] = 0.0
            scans[i, 0] = scan
            scans[i, 1] = -1
            scans[i, 2] = 0
        moments[i, 0] += 1.0
        moments[i, 1] += x
        moments[i, 2] += y
        moments[i, 3] += z
        moments[i, 4] += x * x
        moments[i, 5] += x * y
        moments[i, 6] += x * z
        moments[i, 7] += y * y
        moments[i, 8] += y * z
        moments[i, 9] += z * z
        vx, vy, vz = origin[0] - x, origin[1] - y, origin[2] - z
        norm = np.sqrt(vx * vx + vy * vy + vz * vz) + 1e-9
        views[i, 0] += vx / norm
        views[i, 1] += vy / norm
        views[i, 2] += vz / norm
        if scans[i, 1] != scan:
            scans[i, 1] = scan
            scans[i, 2] += 1
    return size


@numba.njit(cache=True)
def _pooled_covariances(
    positions: Array, moments: NDArray[np.float64], slots: NDArray[np.int32], resolution: float
) -> NDArray[np.float64]:
    """Covariance (n, 3, 3) of the returns around each point: its 27 voxels, Gaussian in distance.

    A voxel counts at most as POOLED_RETURNS returns, so that dense and sparse scans give the same surface.
    """
    out = np.zeros((len(positions), 3, 3))
    for i in range(len(positions)):
        p = positions[i]
        cx, cy, cz = np.floor(p / resolution).astype(np.int64)
        total = 0.0
        first = np.zeros(3)
        second = np.zeros((3, 3))
        for x in range(cx - 1, cx + 2):
            for y in range(cy - 1, cy + 2):
                for z in range(cz - 1, cz + 2):
                    j = slots[voxel_hash.slot_of(x, y, z)]
                    if j < 0:
                        continue
                    m = moments[j]
                    gap = (positions[j, 0] - p[0]) ** 2 + (positions[j, 1] - p[1]) ** 2 + (positions[j, 2] - p[2]) ** 2
                    if gap > 4.0 * resolution**2:
                        continue
                    w = np.exp(-0.5 * gap / (0.7 * resolution) ** 2) * min(m[0], POOLED_RETURNS) / m[0]
                    total += w * m[0]
                    for a in range(3):
                        first[a] += w * (m[1 + a] - m[0] * p[a])
                    entry = 4
                    for a in range(3):
                        for b in range(a, 3):
                            value = m[entry] - p[a] * m[1 + b] - p[b] * m[1 + a] + m[0] * p[a] * p[b]
                            second[a, b] += w * value
                            entry += 1
        for a in range(3):
            for b in range(a, 3):
                value = second[a, b] / total - first[a] / total * first[b] / total
                out[i, a, b] = value
                out[i, b, a] = value
    return out


def _oriented_normals(covariances: NDArray[np.float64], views: NDArray[np.float64]) -> Array:
    """Unit normals (n, 3) towards the sensor: least variance, with a prior for the viewing direction.

    The prior decides where returns form a line (one beam on a wall) or a single spot.
    """
    view = views / (np.linalg.norm(views, axis=1, keepdims=True) + 1e-12)
    spread = np.trace(covariances, axis1=1, axis2=2)[:, None, None] + 1e-9
    prior = np.eye(3) - view[:, :, None] * view[:, None, :]
    normals = np.linalg.eigh(covariances / spread + NORMAL_PRIOR * prior)[1][:, :, 0]
    facing = np.einsum("ij,ij->i", normals, view) < 0
    normals[facing] *= -1
    return normals.astype(np.float32)
