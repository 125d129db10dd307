"""The scans of a drive that are described: those at marks of travelled distance, and those that look elsewhere.

A mark is a multiple of a spacing, counted from the beginning of the session in metres travelled by *all* poses. The way
is counted in steps of a hundredth of a submap, or half a metre: a robot that stands travels nowhere, though its poses
tremble. Of the scans nearest to a mark the first is chosen, so that none has to wait for the next. The rule looks at
nothing but the scans that it has chosen before: a stream that leaves out the others gives the same scans as one that
has them all, wherever the choice is made.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import SubmapConfig
from revisit.core.geometry.se3 import Matrix4

STEPS_PER_TAU = 100
"""A submap is at least so many steps of the way long; a pose nearer to the last step than that is no new one."""

LONGEST_STEP_M = 0.5
"""The way of a robot that goes round in a hall is a way in long submaps, too."""

ROUNDED_M = 1e-6
"""A step that is shorter by less is no shorter: robots drive ten centimetres a scan, in numbers that round."""

MOST_PER_TAU = 640
"""Marks in tau metres at most: a scan of so few returns that more were needed is no scan of a place."""


@dataclass(frozen=True)
class Way:
    """How far a session had travelled, metres, and the pose (4, 4) up to which that is counted."""

    travelled_m: float
    T_odom_sensor: Matrix4


@dataclass(frozen=True)
class ChosenScan:
    """The last scan that was chosen: how far the session had travelled, metres, and the orientations (3, 3) of the
    scans that were chosen since the last mark, its own among them.
    """

    travelled_m: float
    orientations: tuple[NDArray[np.float64], ...]


@dataclass(frozen=True)
class ScanMarks:
    """How far apart marks are, and how far a scan must look elsewhere to be chosen between two of them.

    In `tau_m` metres there are `least_per_tau` marks, twice as many, four times as many...: the fewest at which
    scans such as the one that is asked about have `enough_returns` together. Of scans at one mark each looks
    `turn_rad` radians or more beside all the others. A pose nearer than `least_step_m` to the way's end adds nothing.
    """

    tau_m: float
    least_per_tau: int
    enough_returns: int
    turn_rad: float
    least_step_m: float = 0.0

    @classmethod
    def of(cls, config: SubmapConfig) -> ScanMarks:
        """The marks of a map."""
        turn_rad = math.radians(config.turn_between_scans)
        least_step_m = min(config.tau / STEPS_PER_TAU, LONGEST_STEP_M)
        return cls(config.tau, config.least_scans_per_tau, config.enough_returns, turn_rad, least_step_m)

    def way_to(self, T_odom_sensor: Matrix4, way: Way | None) -> Way:
        """The way with one pose more; it begins where there is none."""
        if way is None:
            return Way(0.0, T_odom_sensor)
        step_m = float(np.linalg.norm(T_odom_sensor[:3, 3] - way.T_odom_sensor[:3, 3]))
        return way if step_m < self.least_step_m - ROUNDED_M else Way(way.travelled_m + step_m, T_odom_sensor)

    def spacing_m(self, returns: int) -> float:
        """Metres between two marks of scans with so many returns."""
        count = self.least_per_tau
        while count * returns < self.enough_returns and count < MOST_PER_TAU:
            count *= 2
        return self.tau_m / count

    def choose(
        self, last: ChosenScan | None, travelled_m: float, T_odom_sensor: Matrix4, returns: int
    ) -> ChosenScan | None:
        """The scan as the one that was chosen last, where it is chosen; None where it is left out.

        `last` is None before the first scan, which is chosen.
        """
        orientation = T_odom_sensor[:3, :3]
        if last is None or self._mark(travelled_m, returns) > self._mark(last.travelled_m, returns):
            return ChosenScan(travelled_m, (orientation,))
        cosine = math.cos(self.turn_rad)
        # The trace of the rotation between two orientations is 1 + 2 cos of its angle.
        if any(float(np.vdot(known, orientation)) > 1.0 + 2.0 * cosine for known in last.orientations):
            return None
        return ChosenScan(last.travelled_m, (*last.orientations, orientation))

    def _mark(self, travelled_m: float, returns: int) -> int:
        """The number of the mark that is nearest."""
        return math.floor(travelled_m / self.spacing_m(returns) + 0.5)


def way_along(poses: Iterable[Matrix4], marks: ScanMarks) -> Way | None:
    """The way over the poses (4, 4) of a drive, in time order; None where there are none."""
    way = None
    for T_odom_sensor in poses:
        way = marks.way_to(T_odom_sensor, way)
    return way


def marked_rows(poses: Iterable[tuple[Matrix4, int]], marks: ScanMarks) -> list[int]:
    """The rows of the scans that are chosen of a part of a drive, of which the first one is a mark.

    `poses` are T_odom_sensor and the number of returns of each, in time order.
    """
    rows, last, way = list[int](), None, None
    for row, (T_odom_sensor, returns) in enumerate(poses):
        way = marks.way_to(T_odom_sensor, way)
        chosen = marks.choose(last, way.travelled_m, T_odom_sensor, returns)
        if chosen is not None:
            rows.append(row)
            last = chosen
    return rows
