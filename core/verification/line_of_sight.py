"""Free space as evidence against an alignment: nothing of one place stands where the other has looked through.

A place holds surface points and no rays. But a sensor that saw a surface in some direction saw nothing in front of it
(docs/decisions/0018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.kernels.view_ranges import LOWEST_DEG, ROWS, looked_through, nearest_around, nearest_ranges

Array64 = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """The view of a place from its origin: nearest ranges (columns, rows) in metres, and the least around each."""

    ranges: Array64
    around: Array64


def view_of(seen: Array64, angle_deg: float) -> View:
    """The view of the surface points `seen` (m, 3), in pixels of `angle_deg`."""
    ranges = nearest_ranges(np.ascontiguousarray(seen), angle_deg, round(360.0 / angle_deg))
    return View(ranges, nearest_around(ranges))


def seen_through(
    points: Array64, T_view_points: se3.Matrix4, view: View, config: VerificationConfig
) -> tuple[int, int]:
    """How many of `points` (n, 3) a view contradicts, and of how many it tells anything.

    `T_view_points` (4, 4) moves them into the frame of the place that has the view, whose origin is where it was seen
    from. A point is contradicted where everything seen in its direction and next to it lies farther by more than
    `sight_margin`; it is confirmed where that lies at its range, and hidden, which tells nothing, where something
    stands before it.
    """
    through, judged = looked_through(
        np.ascontiguousarray(points), np.ascontiguousarray(T_view_points), view.ranges, view.around,
        config.sight_angle, config.sight_near, config.sight_far, config.sight_margin,
    )  # fmt: skip
    return int(through), int(judged)


def plain_seen_through(points: Array64, seen: Array64, config: VerificationConfig) -> tuple[int, int]:
    """The plain form of `seen_through` with the view of `seen` (m, 3), which is compiled."""
    image, where, distance = _range_image(seen, config), _direction(points, config), np.linalg.norm(points, axis=1)
    inside = np.isfinite(image[where]) & (distance > config.sight_near) & (distance < config.sight_far)
    behind = _with_neighbours(image)[where] - distance
    through = inside & (behind > config.sight_margin)
    confirmed = inside & (np.abs(behind) <= config.sight_margin)
    return int(through.sum()), int(through.sum() + confirmed.sum())


def _range_image(points: Array64, config: VerificationConfig) -> Array64:
    """The nearest range (columns, rows) in metres by azimuth and elevation; infinite where nothing was seen."""
    image = np.full((round(360.0 / config.sight_angle), ROWS), np.inf)
    np.minimum.at(image, _direction(points, config), np.linalg.norm(points, axis=1))
    return image


def _direction(points: Array64, config: VerificationConfig) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    columns = round(360.0 / config.sight_angle)
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) + 180.0
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    row = np.floor((elevation - LOWEST_DEG) / config.sight_angle).astype(np.int64)
    return (azimuth / config.sight_angle).astype(np.int64) % columns, np.clip(row, 0, ROWS - 1)


def _with_neighbours(image: Array64) -> Array64:
    """The smallest value of each pixel and its eight neighbours; azimuth goes round."""
    around = np.minimum(np.minimum(np.roll(image, 1, axis=0), image), np.roll(image, -1, axis=0))
    padded = np.pad(around, ((0, 0), (1, 1)), constant_values=np.inf)
    return np.asarray(np.minimum(np.minimum(padded[:, :-2], around), padded[:, 2:]))
