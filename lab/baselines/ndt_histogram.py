"""NDT histograms (Magnusson et al., ICRA 2009): how many cells are spherical, linear, or planar in each direction.

The cloud is divided into cells; the eigenvalues of each cell's covariance give its class. Histograms are taken by range
and compared after turning the most common plane normals to fixed axes, which makes them independent of the heading.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from revisit.core.scan import Points
from revisit.evaluation.baselines.place_recogniser import Descriptor

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class NdtHistogram:
    """Cells of `cell_m`; an eigenvalue is small below `flat` of the next one (paper: 0.5 m, 0.10).

    `planes` directions over the half sphere (9); `range_edges_m` the outer limits of the range bins. Clouds whose peaks
    are not clear (other peaks above `ambiguity` of the highest) get up to `turns` alignments (an even number).
    """

    cell_m: float = 1.0
    flat: float = 0.10
    planes: int = 9
    range_edges_m: tuple[float, ...] = (3.0, 6.0, 9.0, 15.0, 30.0, 80.0)
    ambiguity: float = 0.6
    turns: int = 4
    min_points: int = 5

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        return "ndt-histogram"

    def describe(self, points: Points) -> Descriptor:
        """(turns, ranges * (planes + 2)): the histogram under every alignment; rows repeat where there are fewer."""
        means, classes, normals = self._cells(points.astype(np.float64))
        ring = np.searchsorted(self.range_edges_m, np.linalg.norm(means, axis=1))
        kept = ring < len(self.range_edges_m)
        turned = [
            self._histogram(ring[kept], classes[kept], normals[kept] @ alignment.T)
            for alignment in self._alignments(normals[kept & (classes == _PLANAR)])
        ]
        return np.stack([turned[index % len(turned)] for index in range(self.turns)]).astype(np.float32)

    def similarities(self, query: Descriptor, places: Descriptor) -> NDArray[np.float64]:
        """1 - half the distance of the best pair of alignments, histograms scaled to the sum 1.

        The distance grows with the ratio of the two numbers of cells, as in the paper.
        """
        query_cells, place_cells = float(query[0].sum()), places[:, 0].sum(axis=1).astype(np.float64)
        asked = query / max(query_cells, 1e-9)
        known = places / np.maximum(place_cells, 1e-9)[:, None, None]
        distance = np.linalg.norm(known[:, :, None] - asked[None, None], axis=3).min(axis=(1, 2))
        ratio = np.maximum(query_cells, place_cells) / np.maximum(np.minimum(query_cells, place_cells), 1e-9)
        return np.asarray(1.0 - 0.5 * distance * ratio, dtype=np.float64)

    @cached_property
    def _directions(self) -> Floats:
        """Unit vectors (planes, 3), spread over the upper half sphere by a spiral; the first is the zenith."""
        index = np.arange(self.planes)
        z = 1.0 - index / self.planes
        angle = index * np.pi * (3.0 - np.sqrt(5.0))
        return np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=1)

    def _cells(self, points: Floats) -> tuple[Floats, NDArray[np.int64], Floats]:
        """Means (c, 3), classes (c,) and normals (c, 3) of the cells with enough points."""
        _, cell, count = np.unique(np.floor(points / self.cell_m).astype(np.int64), axis=0, return_inverse=True,
                                   return_counts=True)  # fmt: skip
        cell = cell.ravel()
        mean = np.stack([np.bincount(cell, points[:, axis]) for axis in range(3)], axis=1) / count[:, None]
        offset = points - mean[cell]
        covariance = np.empty((len(count), 3, 3))
        for i in range(3):
            for j in range(3):
                covariance[:, i, j] = np.bincount(cell, offset[:, i] * offset[:, j]) / count
        full = count >= self.min_points
        values, vectors = np.linalg.eigh(covariance[full])
        classes = np.full(len(values), _SPHERICAL)
        classes[values[:, 1] < self.flat * values[:, 2]] = _LINEAR
        classes[(values[:, 0] < self.flat * values[:, 1]) & (classes == _SPHERICAL)] = _PLANAR
        return mean[full], classes, vectors[:, :, 0]

    def _histogram(self, ring: NDArray[np.int64], classes: NDArray[np.int64], normals: Floats) -> Floats:
        nearest = np.abs(normals @ self._directions.T).argmax(axis=1)
        kind = np.where(classes == _PLANAR, nearest + 2, classes)
        counts = np.bincount(ring * (self.planes + 2) + kind, minlength=len(self.range_edges_m) * (self.planes + 2))
        return counts.astype(np.float64)

    def _alignments(self, normals: Floats) -> list[Floats]:
        """Rotations (3, 3) that turn the horizontal normals' peaks, highest first, to the x axis. Submaps are level."""
        upright = normals[np.abs(normals[:, 2]) < 0.3]
        angle = np.mod(np.arctan2(upright[:, 1], upright[:, 0]), np.pi)
        peaks = _peaks(angle, self.ambiguity, self.turns // 2)
        # A normal has two signs, so a peak gives two alignments, half a turn apart.
        both = [peak + half for peak in peaks for half in (0.0, np.pi)]
        return [np.array([[np.cos(a), np.sin(a), 0.0], [-np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]]) for a in both]


_SPHERICAL, _LINEAR, _PLANAR = 0, 1, 2


def _peaks(angle: Floats, ambiguity: float, most: int) -> list[float]:
    """Directions in [0, pi) where many of the `angle` (n,) are, refined to the mean around them; [0] without any."""
    bins = 36
    counts = np.bincount((angle / np.pi * bins).astype(np.int64) % bins, minlength=bins).astype(np.float64)
    smooth = counts + 0.5 * (np.roll(counts, 1) + np.roll(counts, -1))
    local = (smooth >= np.roll(smooth, 1)) & (smooth > np.roll(smooth, -1)) & (smooth >= ambiguity * smooth.max())
    order = np.flatnonzero(local & (smooth > 0))
    chosen = order[np.argsort(-smooth[order], kind="stable")][:most]
    peaks = []
    for index in chosen:
        centre = (index + 0.5) * np.pi / bins
        # Angles of lines are doubled for averaging, because 0 and pi are the same direction.
        off = np.angle(np.exp(2j * (angle - centre))) / 2
        near = np.abs(off) < 1.5 * np.pi / bins
        peaks.append(float(centre + off[near].mean()))
    return peaks or [0.0]
