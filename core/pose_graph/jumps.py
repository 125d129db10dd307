"""Steps of odometry that no robot drives: it began anew, at its origin, or in the frame of another map.

A jump is told by its time: the way to the next submap is many times as fast as those before and behind it. A robot
whose scans paused while it drove on is as fast as before, or goes on ahead no faster than a car. Of such a step nothing
is known but that the robot went on: it is taken as the step before it, in any direction, and the loops on either side
say the rest.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.pose_graph.faults import FaultKind, Mending, OdometryFault, steps_of
from revisit.core.pose_graph.graph import PoseGraph, Trajectory

Array64 = NDArray[np.float64]

JUMP_M, TIMES_AS_LONG, TIMES_AS_FAST = 15.0, 3.0, 5.0
"""Metres of a step, its length over the median, and its speed over that of the steps near it: a jump is beyond all."""

LEAST_SPEED, TIMES_THE_FASTEST = 2.5, 1.5
"""Metres a second, and times the speed that one step in ten of a session is beyond: slower ways are driven. A robot
that works from stop to stop, or is in a jam, is slow beside a way without stops."""

ONWARD_SPEED, ONWARD_COSINE = 15.0, float(np.cos(np.radians(45.0)))
"""Metres a second, and the angle to the steps beside it, of a way that a robot drove on ahead, without scans."""

NEAR_STEPS = 2
"""Steps before and behind, all of which are slower: a robot that speeds up goes on so."""

UNKNOWN_M, UNKNOWN_RAD = 10.0, float(np.radians(90.0))
"""Standard deviations of the motion between submaps of which odometry tells nothing: a robot may have turned round."""


def jumps(T_odom_submap: Array64, stamps_ns: NDArray[np.int64]) -> tuple[int, ...]:
    """The submaps behind which the odometry (n, 4, 4) of a session jumps; none where its times (n,) do not rise."""
    seconds = np.diff(stamps_ns) / 1e9
    if len(seconds) <= 2 * NEAR_STEPS or (seconds <= 0.0).any():
        return ()
    steps = np.diff(T_odom_submap[:, :3, 3], axis=0)
    steps_m = np.linalg.norm(steps, axis=1)
    speeds = steps_m / seconds
    around = np.pad(speeds, NEAR_STEPS)
    beside = [np.roll(around, by)[NEAR_STEPS:-NEAR_STEPS] for by in range(-NEAR_STEPS, NEAR_STEPS + 1) if by]
    driven = max(LEAST_SPEED, TIMES_THE_FASTEST * float(np.quantile(speeds, 0.9, method="lower")))
    fast = speeds > np.maximum(driven, TIMES_AS_FAST * np.max(beside, axis=0))
    far = steps_m > max(JUMP_M, TIMES_AS_LONG * float(np.median(steps_m)))
    driven_on = (speeds <= ONWARD_SPEED) & _goes_on(steps)
    return tuple(np.flatnonzero(fast & far & ~driven_on).tolist())


def _goes_on(steps: Array64) -> NDArray[np.bool_]:
    """Which steps (n, 3) in odometry lead on ahead, as the ones before and behind do."""
    lengths = np.linalg.norm(steps, axis=1)
    turns = np.einsum("ni,ni->n", steps[1:], steps[:-1]) > ONWARD_COSINE * lengths[1:] * lengths[:-1]
    return np.asarray(np.append(False, turns) & np.append(turns, False))


def without_jumps(graph: PoseGraph) -> tuple[PoseGraph, list[OdometryFault]]:
    """The graph whose sessions go on, at their jumps, as before, as unsure as that is; and the jumps as faults."""
    mendings = [_mending(one, step) for one in graph.trajectories for step in one.jumps]
    if not mendings:
        return graph, []
    tracks = dict(graph.by_session)
    for one in mendings:
        tracks[one.fault.session] = one.applied(tracks[one.fault.session])
    mended = replace(graph, trajectories=tuple(tracks[one.session] for one in graph.trajectories))
    return mended, [one.fault for one in mendings]


def _mending(track: Trajectory, step: int) -> Mending:
    """The step of a jump as the nearest one that is none, the earlier of two."""
    motions = steps_of(track)
    known = np.setdiff1d(np.arange(len(motions)), track.jumps)
    like = known[np.abs(known - step).argmin()]
    amount = float(np.linalg.norm(motions[step, :3, 3] - motions[like, :3, 3]))
    fault = OdometryFault(track.session, FaultKind.JUMP, step, step + 1, amount, UNKNOWN_M, 0)
    unknown = np.square(np.repeat([UNKNOWN_M, UNKNOWN_RAD], 3))
    variances = np.maximum(unknown - np.diagonal(track.step_covariances[step]), 0.0)
    return Mending(fault, motions[like][None], variances[None])
