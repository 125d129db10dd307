"""M2DP (He et al., IROS 2016): density signatures of projections onto many planes, their first singular vectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.scan import Points
from revisit.evaluation.baselines.place_recogniser import Descriptor


@dataclass(frozen=True)
class M2dp:
    """Planes of `azimuths` x `elevations` normals; `circles` x `sectors` bins a plane (the paper's 4, 16, 8, 16)."""

    azimuths: int = 4
    elevations: int = 16
    circles: int = 8
    sectors: int = 16
    max_points: int = 20_000

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        return "m2dp"

    def describe(self, points: Points) -> Descriptor:
        """First left and right singular vector (azimuths * elevations + circles * sectors,) of all signatures.

        At most `max_points` evenly chosen points are used, about their centroid and principal axes.
        """
        thinned = points[:: max(1, len(points) // self.max_points)].astype(np.float64)
        aligned = _principal_frame(thinned)
        furthest = float(np.linalg.norm(aligned, axis=1).max())
        signatures = np.stack([self._signature(aligned, *angles, furthest) for angles in self._plane_angles()])
        left, _, right = np.linalg.svd(signatures, full_matrices=False)
        # The signs of singular vectors are arbitrary: both are made mostly positive.
        u, v = left[:, 0], right[0]
        return np.concatenate([u * np.sign(u.sum()), v * np.sign(v.sum())]).astype(np.float32)

    def similarities(self, query: Descriptor, places: NDArray[np.float32]) -> NDArray[np.float64]:
        """1 - half the Euclidean distance."""
        return np.asarray(1.0 - np.linalg.norm(places - query, axis=1) / 2.0, dtype=np.float64)

    def _plane_angles(self) -> list[tuple[float, float]]:
        azimuths = np.linspace(-np.pi / 2, np.pi / 2, self.azimuths)
        elevations = np.linspace(0.0, np.pi / 2, self.elevations)
        return [(float(azimuth), float(elevation)) for azimuth in azimuths for elevation in elevations]

    def _signature(
        self, points: NDArray[np.float64], azimuth: float, elevation: float, furthest: float
    ) -> NDArray[np.float64]:
        """Share of the points (circles * sectors,) in the polar bins of one plane."""
        normal = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
        x_axis = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
        length = float(np.linalg.norm(x_axis))
        x_axis = x_axis / length if length > 1e-6 else np.array([0.0, 1.0, 0.0])
        x, y = points @ x_axis, points @ np.cross(normal, x_axis)
        # Radii of circles grow with the square of their number, as in the authors' description.
        circle = np.minimum((np.sqrt(np.hypot(x, y) / furthest) * self.circles).astype(np.int64), self.circles - 1)
        turn = np.mod(np.arctan2(y, x), 2 * np.pi) / (2 * np.pi)
        sector = np.minimum((turn * self.sectors).astype(np.int64), self.sectors - 1)
        counts = np.bincount(circle * self.sectors + sector, minlength=self.circles * self.sectors)
        return np.asarray(counts / len(points), dtype=np.float64)


def _principal_frame(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points (n, 3) about their centroid, turned to their two main axes; each axis points where the skew is."""
    centred = points - points.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1][:, ::-1]
    first, second = (axes[:, k] * (1.0 if ((centred @ axes[:, k]) ** 3).sum() >= 0 else -1.0) for k in (0, 1))
    return np.asarray(centred @ np.stack([first, second, np.cross(first, second)], axis=1))
