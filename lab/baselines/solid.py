"""SOLiD (Kim et al., RAL 2024): counts by range and elevation, weighted by how much each elevation sees.

Made for narrow fields of view: it stores two short vectors instead of an image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.scan import Points
from revisit.evaluation.baselines.place_recogniser import Descriptor


@dataclass(frozen=True)
class Solid:
    """Counts in `ranges` x `sectors` x `elevations` bins to `max_range_m`, between two elevations."""

    ranges: int = 40
    sectors: int = 60
    elevations: int = 32
    max_range_m: float = 80.0
    lowest_deg: float = -25.0
    highest_deg: float = 15.0

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        return "solid"

    def describe(self, points: Points) -> Descriptor:
        """(ranges + sectors,): the weighted counts by range (R-SOLiD), then by azimuth (A-SOLiD)."""
        radius = np.hypot(points[:, 0], points[:, 1])
        elevation = np.degrees(np.arctan2(points[:, 2], radius))
        inside = (radius < self.max_range_m) & (elevation >= self.lowest_deg) & (elevation < self.highest_deg)
        ring = (radius[inside] / self.max_range_m * self.ranges).astype(np.int64)
        share = (elevation[inside] - self.lowest_deg) / (self.highest_deg - self.lowest_deg)
        level = np.minimum((share * self.elevations).astype(np.int64), self.elevations - 1)
        turn = np.mod(np.arctan2(points[inside, 1], points[inside, 0]), 2 * np.pi) / (2 * np.pi)
        sector = np.minimum((turn * self.sectors).astype(np.int64), self.sectors - 1)
        weight = _stretched(np.bincount(level, minlength=self.elevations).astype(np.float64))
        by_range = np.bincount(ring, weight[level], self.ranges)
        by_azimuth = np.bincount(sector, weight[level], self.sectors)
        return np.concatenate([by_range, by_azimuth]).astype(np.float32)

    def similarities(self, query: Descriptor, places: Descriptor) -> NDArray[np.float64]:
        """Cosine of the counts by range: they do not change with the heading."""
        asked, known = query[: self.ranges].astype(np.float64), places[:, : self.ranges].astype(np.float64)
        length = np.linalg.norm(known, axis=1) * np.linalg.norm(asked)
        return np.asarray(known @ asked / np.maximum(length, 1e-9), dtype=np.float64)

    def yaw_shift(self, query: Descriptor, place: Descriptor) -> int:
        """How many sectors the query must be turned forward so that the counts by azimuth differ least."""
        asked, known = query[self.ranges :], place[self.ranges :]
        differences = [np.abs(np.roll(asked, shift) - known).sum() for shift in range(self.sectors)]
        return int(np.argmin(differences))


def _stretched(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """The counts (n,) scaled so that the least becomes 0 and the most 1; ones where all are equal."""
    spread = float(np.ptp(counts))
    return (counts - counts.min()) / spread if spread > 0 else np.ones_like(counts)
