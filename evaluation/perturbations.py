"""Making recordings harder on purpose: fewer beams, fewer points, any heading."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from revisit.core.geometry import se3
from revisit.core.scan import Points
from revisit.core.submap import Submap

SOURCE_BEAMS = 64


@dataclass(frozen=True)
class Perturbation:
    """A change of a recording before it is described.

    keep_beams: how many of 64 elevation bins are kept, None for all; keep_points: share of the points that are kept,
    0 < share <= 1; view_deg: the width of the view about x of the sensor, 0 < width <= 360, as a
    solid-state LiDAR has it; rotate_seed: seed of the independent uniform yaw of every submap, None for no turning.
    """

    keep_beams: int | None = None
    keep_points: float = 1.0
    rotate_seed: int | None = None
    view_deg: float = 360.0

    def __post_init__(self) -> None:
        if self.keep_beams is not None and self.keep_beams < 1:
            raise ValueError(f"keep_beams must be at least 1, got {self.keep_beams}")
        if not 0.0 < self.keep_points <= 1.0:
            raise ValueError(f"keep_points must lie in (0, 1], got {self.keep_points}")
        if not 0.0 < self.view_deg <= 360.0:
            raise ValueError(f"view_deg must lie in (0, 360], got {self.view_deg}")

    def thin(self, points: Points, scan_index: int) -> Points:
        """The points (n, 3) of a scan that are left; the same scan keeps the same points."""
        if self.view_deg < 360.0:
            points = points[np.abs(np.arctan2(points[:, 1], points[:, 0])) < np.radians(self.view_deg) / 2]
        if self.keep_beams is not None:
            points = keep_beams(points, self.keep_beams)
        if self.keep_points < 1.0:
            rng = np.random.default_rng([61, scan_index])
            points = points[rng.random(len(points)) < self.keep_points]
        return points

    def yaw(self, submap_index: int) -> float:
        """The yaw in radians by which a submap is turned."""
        if self.rotate_seed is None:
            return 0.0
        return float(np.random.default_rng([self.rotate_seed, 62, submap_index]).uniform(-np.pi, np.pi))


def keep_beams(points: Points, beams: int, source_beams: int = SOURCE_BEAMS) -> Points:
    """The points (n, 3) of `beams` evenly chosen elevation bins of those that hold points.

    Works without knowing the sensor: `source_beams` bins divide the elevations that occur (0.5 to 99.5 percentile), and
    those that hold less than a tenth of the fullest lie between two beams. The share that stays is about beams over the
    number of others; where there are no more than `beams` of them, all points stay.
    """
    if beams >= source_beams or len(points) == 0:
        return points
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    low, high = np.percentile(elevation, [0.5, 99.5])
    bins = np.clip(((elevation - low) / max(high - low, 1e-9) * source_beams).astype(np.int64), 0, source_beams - 1)
    counts = np.bincount(bins, minlength=source_beams)
    seen = np.flatnonzero(counts >= 0.1 * counts.max())
    if beams >= len(seen):
        return points
    kept = np.zeros(source_beams, dtype=bool)
    kept[seen[((np.arange(beams) + 0.5) * len(seen) / beams).astype(np.int64)]] = True
    return np.asarray(points[kept[bins]], dtype=np.float32)


def turned(submap: Submap, yaw: float) -> Submap:
    """The submap in a frame in which everything is turned by `yaw` radians about z."""
    T_turned_submap = se3.from_yaw(yaw)
    return dataclasses.replace(
        submap,
        points=se3.apply(T_turned_submap, submap.points).astype(np.float32),
        origins=se3.apply(T_turned_submap, submap.origins).astype(np.float32),
        T_odom_submap=submap.T_odom_submap @ se3.inverse(T_turned_submap),
    )
