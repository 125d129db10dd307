"""Faults of odometry that loops show: told to the session, and taken out before its loops are judged."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3, se3_rows
from revisit.core.geometry.path import travelled_m
from revisit.core.pose_graph.graph import Trajectory

Array64 = NDArray[np.float64]


LEAST_LOOPS = 5
"""Loops on each side of a fault at once, at least, that show it."""

MOST_SOLVED_TWICE = 4000
"""Submaps of a graph that is solved again for faults in doubt: of 10,000 one answer takes 40 s."""


class FaultKind(StrEnum):
    """The kinds of faults.

    At once: way lost or made up (SLIP), a jump aside (JUMP), a wrong turn (TURN) or tilt (TILT). Throughout: lengths
    (SCALE), climb (SLOPE) or heading (HEADING) wrong by so much a metre.
    """

    SLIP = "SLIP"
    JUMP = "JUMP"
    TURN = "TURN"
    TILT = "TILT"
    SCALE = "SCALE"
    SLOPE = "SLOPE"
    HEADING = "HEADING"

    @property
    def is_at_once(self) -> bool:
        """Whether it is one broken step, and not wrong throughout."""
        return self in (FaultKind.SLIP, FaultKind.JUMP, FaultKind.TURN, FaultKind.TILT)


@dataclass(frozen=True)
class OdometryFault:
    """A fault of a session's odometry, taken out before its loops were judged.

    first and last: the submaps between which it lies; loops of neither side tell where. amount: metres of a slip or
    jump, radians of a turn or tilt, metres or radians a metre of a steady fault; sigma is its standard
    deviation. loops: how many speak for it. undecided: loops of one place alone show it on a side, or it is a large
    turn, so that it may be a place that is taken for another one; the poses do not have it taken out.
    """

    session: str
    kind: FaultKind
    first: int
    last: int
    amount: float
    sigma: float
    loops: int
    undecided: bool = False

    def is_beside(self, other: OdometryFault) -> bool:
        """Whether both may be one broken step: faults at once of a session that share a submap."""
        at_once = self.kind.is_at_once and other.kind.is_at_once
        return at_once and self.session == other.session and self.first <= other.last and other.first <= self.last


@dataclass(frozen=True)
class Mending:
    """A fault with its mending: the motions (n, 4, 4) of the steps from submap `fault.first` on, and the variances
    (n, 6) that they have beyond those of the odometry.
    """

    fault: OdometryFault
    motions: Array64
    variances: Array64

    def applied(self, track: Trajectory) -> Trajectory:
        """The session with these steps instead of its own."""
        motions, covariances = steps_of(track), track.step_covariances.copy()
        steps = slice(self.fault.first, self.fault.last)
        motions[steps] = self.motions
        covariances[steps] += self.variances[:, :, None] * np.eye(6)
        poses = composed(track.T_odom_submap[0], motions)
        mended = (*track.mended, (self.fault.first, self.fault.last)) if self.fault.kind.is_at_once else track.mended
        return replace(track, T_odom_submap=poses, step_covariances=covariances, mended=mended)

    def undecided(self) -> Mending:
        """The mending of a fault that is undecided."""
        return replace(self, fault=replace(self.fault, undecided=True))


def doubt(T_map_submap: Array64, others: Array64) -> Array64:
    """The covariances (n, 6, 6) that poses (n, 4, 4) have beyond their own where they may as well be others."""
    apart = se3_rows.log(se3_rows.inverse(T_map_submap) @ others)
    return np.asarray(apart[:, :, None] * apart[:, None, :])


def torn(track: Trajectory, mended: Array64, faults: Iterable[OdometryFault], window_m: float) -> Array64:
    """The covariances (n, 6, 6) that submaps have beyond their own whose windows a broken step may lie within, of
    `window_m` metres of the way around them: their clouds, and so their loops, hold either side of it.

    `mended` (n, 4, 4): the odometry without the `faults` of the session. A turn shifts all but the place where it
    happened. Zero for steps longer than a window, which
    ends there.
    """
    found, at_once = np.zeros((len(track), 6, 6)), [one for one in faults if one.kind.is_at_once]
    if not at_once:
        return found
    along_m, right = travelled_m(mended[:, :3, 3]), steps_of(replace(track, T_odom_submap=mended))
    errors = se3_rows.log(se3_rows.inverse(right) @ steps_of(track))
    for fault in at_once:
        error = errors[fault.first : fault.last].sum(axis=0)
        if np.linalg.norm(error[:3]) < window_m:
            beside_m = np.maximum(along_m[fault.first] - along_m, along_m - along_m[fault.last])
            lever_m = window_m / 4.0  # of the half of a window that is turned, on average
            shift = np.square(np.repeat([lever_m * np.linalg.norm(error[3:]), 0.0], 3))
            found[beside_m < window_m / 2.0] += np.outer(error, error) + np.diag(shift)
    return found


def steps_of(track: Trajectory) -> Array64:
    """The motions (n - 1, 4, 4) from each submap to the next."""
    return np.asarray(se3_rows.inverse(track.T_odom_submap[:-1]) @ track.T_odom_submap[1:])


def composed(start: se3.Matrix4, motions: Array64) -> Array64:
    """The poses (n + 1, 4, 4) after none, one, two ... of the motions (n, 4, 4)."""
    return np.stack(list(itertools.accumulate(motions, np.matmul, initial=start)))
