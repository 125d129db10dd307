"""Odometry whose lengths, climb or heading are wrong throughout, by the loops with other sessions.

Two loops with another session say how far apart their submaps lie, and so does the odometry between them. Where it
says too little or too much by the same share all along the way, it is a scale; by the same rise a metre, a slope; by
the same turn a metre, a heading (the one that loops within a session show is `heading_bias`). Which of two sessions is
wrong no loop between them tells: the one that gives the frame is believed, or most sessions.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3_rows
from revisit.core.geometry.path import travelled_m
from revisit.core.geometry.upright import turned_up
from revisit.core.pose_graph.consistency import oriented
from revisit.core.pose_graph.faults import FaultKind, Mending, OdometryFault, steps_of
from revisit.core.pose_graph.graph import LoopEdge, PoseGraph, Trajectory
from revisit.core.pose_graph.support import STRETCH

Array64 = NDArray[np.float64]

KINDS = FaultKind.SCALE, FaultKind.SLOPE, FaultKind.HEADING

LEAST = np.array([0.025, 0.02, float(np.radians(0.03))])
"""Of each of KINDS: less is drift, metres or radians a metre."""

MOST = np.array([0.15, 0.08, float(np.radians(0.3))])
"""Of each of KINDS: more is no fault of odometry; a ramp climbs by a tenth and more."""

NEAREST, FARTHEST = 4, 12
"""Submaps between the ends of two loops that are compared: farther ones add up other drift, too."""

LEAST_PAIRS, LEAST_PLACES = 20, 3

STEADY = 0.5
"""Of the median: so much the quartiles of all places reach, too, where a fault goes on throughout."""

_LEVEL_COSINE = float(np.cos(np.radians(15.0)))
"""Axes that lean less are level, on a slope perhaps."""


@dataclass(frozen=True)
class _Rates:
    """The error of one session a metre as others have it (3,), as KINDS; zero where it is not steady.

    sigma (3,) is its standard deviation; loops, how many say so.
    """

    rates: Array64
    sigma: Array64
    loops: int


_NONE = _Rates(np.zeros(3), np.zeros(3), 0)


def steady_faults(graph: PoseGraph, loops: Collection[int], group: Sequence[str]) -> list[Mending]:
    """Steady faults of sessions that share a frame, the first of which gives it.

    `loops`, by number, are those that may be right: within these sessions, and with others beside them that agree.
    """
    known, off = [group[0]], {group[0]: _NONE}
    for session in group[1:]:
        found = _against(graph, loops, session, known, off)
        off[session] = found
        known.append(session)
    believed = _most_agreed([off[session].rates for session in group])
    return [one for session in group for one in _mendings(graph.by_session[session], off[session], believed)]


def _most_agreed(rates: Sequence[Array64]) -> Array64:
    """Of each kind the rate that is nearest to all; that of the first one where several are."""
    table = np.stack(rates)
    apart = np.abs(table[:, None, :] - table[None, :, :]).sum(axis=1)
    return np.asarray(np.take_along_axis(table, np.round(apart, 9).argmin(axis=0)[None, :], axis=0)[0])


def _against(
    graph: PoseGraph, loops: Collection[int], session: str, known: Sequence[str], off: dict[str, _Rates]
) -> _Rates:
    """The rates of a session by those before it."""
    track, rates, ends = graph.by_session[session], [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    for other in known:
        joining = [graph.loops[n] for n in sorted(loops) if _joins(graph.loops[n], session, other)]
        if len(joining) > 1:
            seen, at = _pair_rates([oriented(one, other) for one in joining], graph.by_session[other], track)
            rates.append(seen + off[other].rates)
            ends.append(at)
    found, at = np.concatenate(rates), np.concatenate(ends)
    places, numbers = np.unique(at // STRETCH, return_inverse=True)
    if len(found) < LEAST_PAIRS or len(places) < LEAST_PLACES:
        return _NONE
    medians = np.stack([np.median(found[numbers == place], axis=0) for place in range(len(places))])
    middle, quartiles = np.median(found, axis=0), np.quantile(medians, [0.0, 1.0], axis=0)
    steady = (quartiles * np.sign(middle) >= STEADY * np.abs(middle)).all(axis=0)
    spread = 1.4826 * np.median(np.abs(found - middle), axis=0) / np.sqrt(len(places))
    is_fault = steady & (np.abs(middle) <= MOST)
    return _Rates(np.where(is_fault, middle, 0.0), spread, len(np.unique(at)))


def _joins(loop: LoopEdge, session: str, other: str) -> bool:
    return {loop.match.session, loop.query.session} == {session, other}


def _pair_rates(loops: Sequence[LoopEdge], first: Trajectory, second: Trajectory) -> tuple[Array64, NDArray[np.int64]]:
    """Faults of the odometry of `second` by pairs of loops with their query in it: rates (n, 3) and the submap (n,)."""
    ends = np.array([(one.match.ordinal, one.query.ordinal) for one in loops])
    measured = first.T_odom_submap[ends[:, 0]] @ np.stack([one.T_match_query for one in loops])
    apart = ends[None, :, 1] - ends[:, None, 1]
    one, other = np.nonzero((apart >= NEAREST) & (apart <= FARTHEST))
    stated = se3_rows.inverse(second.T_odom_submap[ends[one, 1]]) @ second.T_odom_submap[ends[other, 1]]
    seen = se3_rows.inverse(measured[one]) @ measured[other]
    turn = _level_turn(second)
    stated, seen = turn @ stated @ turn.T, turn @ seen @ turn.T
    way_m = travelled_m(second.T_odom_submap[:, :3, 3])
    way_m = np.maximum(way_m[ends[other, 1]] - way_m[ends[one, 1]], 1e-9)
    lengths = (np.linalg.norm(motion[:, :3, 3], axis=1) for motion in (seen, stated))
    length, of_odometry = lengths
    turned = stated[:, :3, :3].transpose(0, 2, 1) @ seen[:, :3, :3]
    yaw = np.arctan2(turned[:, 1, 0] - turned[:, 0, 1], turned[:, 0, 0] + turned[:, 1, 1])
    rates = np.stack(
        [length / np.maximum(of_odometry, 1e-9) - 1.0, (seen[:, 2, 3] - stated[:, 2, 3]) / way_m, yaw / way_m], axis=1
    )
    return rates, ends[one, 1]


def _mendings(track: Trajectory, found: _Rates, believed: Array64) -> list[Mending]:
    """The mending of a session, one fault of each kind; the first has the motions, the others nothing beyond them."""
    rates = found.rates - believed
    rates = np.where(np.abs(rates) >= LEAST, rates, 0.0)
    kinds = np.flatnonzero(rates)
    if not len(kinds):
        return []
    turn = _level_turn(track)
    motions = turn.T @ _without(turn @ steps_of(track) @ turn.T, rates) @ turn
    last, nothing = len(track) - 1, np.zeros((len(track) - 1, 6))
    amounts = zip(kinds, rates[kinds], found.sigma[kinds], strict=True)
    faults = (OdometryFault(track.session, KINDS[k], 0, last, float(r), float(s), found.loops) for k, r, s in amounts)
    return [Mending(one, motions, nothing) for one in faults]


def _level_turn(track: Trajectory) -> Array64:
    """The turn (4, 4) from the axes of a session's submaps to level ones, where a sensor is not mounted level.

    By the first submap: the vertical of odometry may drift later.
    """
    up = track.T_odom_submap[0, 2, :3]
    return np.eye(4) if up[2] >= _LEVEL_COSINE else turned_up(up)


def _without(motions: Array64, rates: Array64) -> Array64:
    """Motions (n, 4, 4) with lengths, climb and heading as others have them."""
    scale, slope, heading = rates
    mended = motions.copy()
    steps_m = np.linalg.norm(motions[:, :3, 3], axis=1)
    mended[:, :3, 3] *= 1.0 + scale
    mended[:, 2, 3] += slope * steps_m
    turns = np.zeros((len(motions), 6))
    turns[:, 5] = heading * steps_m
    return np.asarray(mended @ se3_rows.exp(turns))
