"""The scans of a drive that are described: those at marks of travelled distance, and those that look elsewhere.

A mark is a multiple of a spacing, counted from the beginning of the session in metres travelled by *all* poses. Of the
scans nearest to a mark the first is chosen, so that none has to wait for the next. The rule looks at nothing but the
scans that it has chosen before: a stream that leaves out the others gives the same scans as one that has them all,
wherever the choice is made.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import SubmapConfig
from revisit.core.geometry.se3 import Matrix4

MOST_PER_TAU = 640
"""Marks in tau metres at most: a scan of so few returns that more were needed is no scan of a place."""


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
    `turn_rad` radians or more beside all the others.
    """

    tau_m: float
    least_per_tau: int
    enough_returns: int
    turn_rad: float

    @classmethod
    def of(cls, config: SubmapConfig) -> ScanMarks:
        """The marks of a map."""
        turn_rad = math.radians(config.turn_between_scans)
        return cls(config.tau, config.least_scans_per_tau, config.enough_returns, turn_rad)

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


def step_m(T_odom_before: Matrix4, T_odom_sensor: Matrix4) -> float:
    """Metres from one pose to the next."""
    return float(np.linalg.norm(T_odom_sensor[:3, 3] - T_odom_before[:3, 3]))


def marked_rows(poses: Iterable[tuple[Matrix4, int]], marks: ScanMarks) -> list[int]:
    """The rows of the scans that are chosen of a part of a drive, of which the first one is a mark.

    `poses` are T_odom_sensor and the number of returns of each, in time order.
    """
    rows, last, before, travelled_m = list[int](), None, None, 0.0
    for row, (T_odom_sensor, returns) in enumerate(poses):
        travelled_m += 0.0 if before is None else step_m(before, T_odom_sensor)
        before = T_odom_sensor
        chosen = marks.choose(last, travelled_m, T_odom_sensor, returns)
        if chosen is not None:
            rows.append(row)
            last = chosen
    return rows
