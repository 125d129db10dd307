"""The lines of a single scan of a rotating LiDAR: which beam a return is of, and its neighbours along the beam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.scan import Points

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class ScanLines:
    """Returns line by line, each line by azimuth: points (n, 3) metres, sensor frame; line (n,), from 0 upwards."""

    points: Floats
    line: Integers


def scan_lines(points: Points, elevations_deg: Sequence[float], tolerance_deg: float = 0.5) -> ScanLines:
    """The lines of one scan (n, 3), metres, in the frame of a sensor whose beams have these elevations (b,).

    A return belongs to the nearest elevation; those farther than the tolerance from all of them are left out. Lines are
    numbered from the lowest beam.
    """
    beams = np.sort(np.asarray(elevations_deg, dtype=np.float64))
    rows = points.astype(np.float64)
    elevation = np.degrees(np.arctan2(rows[:, 2], np.hypot(rows[:, 0], rows[:, 1])))
    line = np.searchsorted((beams[1:] + beams[:-1]) / 2, elevation)
    near = np.abs(beams[line] - elevation) <= tolerance_deg
    rows, line = rows[near], line[near]
    order = np.lexsort((np.arctan2(rows[:, 1], rows[:, 0]), line))
    return ScanLines(rows[order], line[order])


def roughness(lines: ScanLines, reach: int) -> Floats:
    """How far each return lies from its neighbours in its line (n,), in square metres (LOAM's smoothness, not scaled).

    The squared length of the sum of the differences to the `reach` returns before it and after it; lines close to a
    ring. Zero in lines of fewer than 2 `reach` + 1 returns.
    """
    result = np.zeros(len(lines.points))
    starts = np.flatnonzero(np.diff(lines.line, prepend=-1))
    for start, stop in zip(starts, [*starts[1:], len(lines.line)], strict=True):
        if stop - start > 2 * reach:
            result[start:stop] = _ring_roughness(lines.points[start:stop], reach)
    return result


def _ring_roughness(ring: Floats, reach: int) -> Floats:
    closed = np.concatenate([ring[-reach:], ring, ring[:reach]])
    sums = np.cumsum(np.concatenate([np.zeros((1, 3)), closed]), axis=0)
    window = sums[2 * reach + 1 :] - sums[: -2 * reach - 1]
    return np.asarray(((window - (2 * reach + 1) * ring) ** 2).sum(axis=1))
