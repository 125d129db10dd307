"""Deskewing: the points of a sweep moved to where they lie at one time, by the motion of the sensor meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3

KNOTS = 17
"""Poses along a sweep. Between two of them points move on the chord: 2 mm off at 50 m, 3 rad/s and 10 Hz."""


@dataclass(frozen=True)
class SweepMotion:
    """The sensor during a sweep: T_scan_sensor (k, 4, 4) at rising times (k,), nanoseconds since the stamp."""

    offsets_ns: NDArray[np.int64]
    T_scan_sensor: NDArray[np.float64]


def knots(offsets_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """The times (k,) at which poses are needed to deskew points taken at such times (n,), both since the stamp."""
    first, last = int(offsets_ns.min(initial=0)), int(offsets_ns.max(initial=0))
    return np.linspace(first, last, KNOTS).astype(np.int64)


def deskewed(points: NDArray[np.floating], offsets_ns: NDArray[np.int64], motion: SweepMotion) -> NDArray[np.float64]:
    """Points (n, 3), each taken at its time (n,) since the stamp, in the sensor's frame at the stamp."""
    moved = np.empty((len(points), 3))
    times = motion.offsets_ns
    piece = np.clip(np.searchsorted(times, offsets_ns, side="right") - 1, 0, len(times) - 2)
    for index in np.unique(piece):
        rows = piece == index
        length = max(int(times[index + 1] - times[index]), 1)
        share = np.clip((offsets_ns[rows, None] - times[index]) / length, 0.0, 1.0)
        before, after = (se3.apply(motion.T_scan_sensor[at], points[rows]) for at in (index, index + 1))
        moved[rows] = before + share * (after - before)
    return moved
